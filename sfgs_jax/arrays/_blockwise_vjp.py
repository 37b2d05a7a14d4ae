"""Reverse-mode derivative of a function of rows, block by block up to the last row in use.

A map with room to grow has many rows behind the last one in use, and the derivative leaves them out. Each
block computes the function's values again: some sixty intermediate arrays take longer to keep and fetch than
to compute. A block's gradients are complete before they are put together; otherwise XLA computes everything
anew for each column of a result.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

from sfgs_jax.arrays._capacities import rounded_up

_BLOCK = 65_536
"""Rows: enough that starting the many small steps costs little."""

Function = Callable[[PyTree, Bool[Array, " b"], PyTree], tuple[PyTree, PyTree]]


@partial(jax.custom_vjp, nondiff_argnums=(0,))
def map_used_rows(
    function: Function, rows: PyTree, used: Bool[Array, " n"], shared: PyTree
) -> tuple[PyTree, PyTree]:
    """`function(rows, used, shared)` with a gradient of zero in rows behind the last one in use.

    Reverse-mode differentiable in `rows` and `shared`; there is no forward mode.

    Args:
        function: maps each row by itself, given the shared arrays; returns two trees of arrays with a row
            for each, first the differentiable ones, then others.
        rows: floating-point arrays with N rows; those of one dimension are fastest.
        used: (N,) which rows are in use.
        shared: floating-point arrays.
    """
    return _forward(function, rows, used, shared)[0]


def _forward(
    function: Function, rows: PyTree, used: Bool[Array, " n"], shared: PyTree
) -> tuple[tuple[PyTree, PyTree], tuple]:
    return function(rows, used, shared), (rows, used, shared)


def _backward(function: Function, residuals: tuple, cotangents: tuple[PyTree, Any]) -> tuple:
    rows, used, shared = residuals
    count, blocks = used.shape[0], _Blocks(used)
    inputs = blocks.padded((rows, used, cotangents[0]))

    def pull(block: Array, gradients: tuple[PyTree, PyTree]) -> tuple[PyTree, PyTree]:
        of_rows, of_shared = gradients
        values, here, cotangent = blocks.at(block, inputs)
        _, transpose, _ = jax.vjp(lambda r, s: function(r, here, s), values, shared, has_aux=True)
        by_rows, by_shared = transpose(cotangent)
        return blocks.put(block, of_rows, by_rows), jax.tree.map(jnp.add, of_shared, by_shared)

    zeros = jax.tree.map(jnp.zeros_like, (inputs[0], shared))
    of_rows, of_shared = jax.lax.fori_loop(0, blocks.used, pull, zeros)
    return jax.tree.map(lambda x: x[:count], of_rows), None, of_shared


map_used_rows.defvjp(_forward, _backward)


class _Blocks:
    """Blocks of rows, and how many there are up to the last row in use."""

    def __init__(self, used: Bool[Array, " n"]) -> None:
        count = used.shape[0]
        self.size = max(1, min(_BLOCK, count))
        last = jnp.max(jnp.where(used, jnp.arange(1, count + 1, dtype=jnp.int32), 0), initial=0)
        self.used = -(-last // self.size)

    def padded(self, arrays: PyTree) -> PyTree:
        def pad(x: Array) -> Array:
            room = max(self.size, rounded_up(x.shape[0], self.size))
            return jnp.pad(x, [(0, room - x.shape[0])] + [(0, 0)] * (x.ndim - 1))

        return jax.tree.map(pad, arrays)

    def at(self, block: Array | int, arrays: PyTree) -> PyTree:
        return jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, block * self.size, self.size), arrays)

    def put(self, block: Array, arrays: PyTree, values: PyTree) -> PyTree:
        def update(x: Array, new: Array) -> Array:
            return jax.lax.dynamic_update_slice_in_dim(x, new, block * self.size, axis=0)

        return jax.tree.map(update, arrays, values)
