"""Emulation of TensorFloat-32 products on any device, and a list of the products that would use them.

Recent GPUs round the float32 operands of products at the default precision to 10 mantissa bits. A test that
runs a function through `at_tf32` sees on a CPU what such a device would make of it.
"""

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.extend import core

_PRODUCTS = ("dot_general", "conv_general_dilated")
_CALLS = {
    "call": "call_jaxpr",
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "checkpoint": "jaxpr",
    "remat2": "jaxpr",
}
"""Primitives that only call a program, and the parameter that holds it. The program takes the call's place:
derivative rules that stand beside it would bring the original products back."""


class Product(NamedTuple):
    """A product at the default precision: its primitive, and the shapes of its operands."""

    primitive: str
    left: tuple[int, ...]
    right: tuple[int, ...]


def at_tf32(function: Callable[..., Any], *, every: bool = False) -> Callable[..., Any]:
    """The compiled function with TF32 products: float32 operands are rounded to 10 mantissa bits.

    Works through `jit`, loops, branches, custom derivatives and linear solves. To emulate the products of a
    derivative as well, emulate the function that takes the derivative.

    Args:
        function: takes positional arguments, arrays or not.
        every: whether products that ask for a higher precision are rounded too. It shows that a test notices
            TF32 at all.
    """

    def emulated(*args: Any) -> Any:
        traced, shapes, rest = eqx.filter_make_jaxpr(function)(*args)
        leaves = jax.tree.leaves(eqx.filter(args, eqx.is_array))
        # Programs may hold words of 64 bits whatever the mode; here every value has its own type already.
        with jax.enable_x64(True):
            outputs = iter(_run(traced.jaxpr, traced.consts, leaves, every))
        return eqx.combine(jax.tree.map(lambda _: next(outputs), shapes), rest)

    return eqx.filter_jit(emulated)


def default_products(function: Callable[..., Any], *args: Any) -> list[Product]:
    """Every float32 product of a function that runs at the default precision, which is TF32 on some devices.

    Args:
        function: takes positional arguments, arrays or not.
        args: arguments that it is traced with.
    """
    traced, _, _ = eqx.filter_make_jaxpr(function)(*args)
    return [
        Product(eqn.primitive.name, *(v.aval.shape for v in eqn.invars[:2]))
        for eqn in _equations(traced.jaxpr)
        if _rounds(eqn, every=False)
    ]


def _rounds(eqn: Any, *, every: bool) -> bool:
    """True for a float32 product at the default precision; with `every`, at any precision."""
    if eqn.primitive.name not in _PRODUCTS or any(v.aval.dtype != jnp.float32 for v in eqn.invars):
        return False
    precision = eqn.params["precision"]
    default = precision is None or precision == (lax.Precision.DEFAULT,) * 2
    return every or default


def _run(jaxpr: core.Jaxpr, consts: list[Any], args: list[Any], every: bool) -> list[Any]:
    """Evaluate a program with rounded products."""
    known: dict[Any, Any] = dict(zip((*jaxpr.constvars, *jaxpr.invars), (*consts, *args), strict=True))

    def read(variable: Any) -> Any:
        return variable.val if isinstance(variable, core.Literal) else known[variable]

    for eqn in jaxpr.eqns:
        inputs = [read(v) for v in eqn.invars]
        if eqn.primitive.name in _CALLS:
            body = eqn.params[_CALLS[eqn.primitive.name]]
            closed = isinstance(body, core.ClosedJaxpr)
            outputs = (
                _run(body.jaxpr, body.consts, inputs, every) if closed else _run(body, [], inputs, every)
            )
        else:
            if _rounds(eqn, every=every):
                inputs = [lax.reduce_precision(x, exponent_bits=8, mantissa_bits=10) for x in inputs]
            params = {name: _rewritten(value, every) for name, value in eqn.params.items()}
            if _rounds(eqn, every=every):
                params["precision"] = (lax.Precision.HIGHEST,) * 2
            outputs = eqn.primitive.bind(*inputs, **params)
            outputs = outputs if eqn.primitive.multiple_results else [outputs]
        known.update(zip(eqn.outvars, outputs, strict=True))
    return [read(v) for v in jaxpr.outvars]


def _rewritten(value: Any, every: bool) -> Any:
    """A parameter of an equation with the programs in it rewritten: bodies, conditions, branches, solvers."""
    if isinstance(value, core.ClosedJaxpr):
        shapes = [jax.ShapeDtypeStruct(v.aval.shape, v.aval.dtype) for v in value.jaxpr.invars]
        return jax.make_jaxpr(lambda *args: _run(value.jaxpr, value.consts, list(args), every))(*shapes)
    if isinstance(value, core.Jaxpr):
        # A program whose constants are given elsewhere: they are its first inputs while it is rewritten.
        count = len(value.constvars)
        closed = core.ClosedJaxpr(value.replace(constvars=(), invars=(*value.constvars, *value.invars)), ())
        program = _rewritten(closed, every)
        if program.consts:
            raise NotImplementedError("TF32 emulation of an open program that gains constants.")
        inputs = program.jaxpr.invars
        return program.jaxpr.replace(constvars=inputs[:count], invars=inputs[count:])
    if isinstance(value, tuple):
        items = [_rewritten(item, every) for item in value]
        return type(value)(*items) if hasattr(value, "_fields") else tuple(items)
    return value


def _equations(jaxpr: core.Jaxpr) -> Iterator[Any]:
    """All equations of a program and of the programs within it."""
    for eqn in jaxpr.eqns:
        yield eqn
        for value in jax.tree.leaves(
            list(eqn.params.values()), is_leaf=lambda x: isinstance(x, core.Jaxpr | core.ClosedJaxpr)
        ):
            if isinstance(value, core.ClosedJaxpr):
                yield from _equations(value.jaxpr)
            elif isinstance(value, core.Jaxpr):
                yield from _equations(value)
