"""Dataclasses as pytrees, for the state of a run, which every step makes anew.

An `equinox.Module` looks through all its fields whenever it is made, so a state with many keyframes would
take ever longer.
"""

from dataclasses import fields
from typing import Any, TypeVar

import jax

_Class = TypeVar("_Class", bound=type)


def pytree(cls: _Class) -> _Class:
    """Register a frozen dataclass as a pytree.

    Fields with `static` in their metadata belong to its structure, the others are its children. A tree put
    together again may hold anything in place of its arrays, which JAX and Equinox rely on: `__init__` is not
    called.
    """
    names = [f.name for f in fields(cls) if not f.metadata.get("static")]
    static = [f.name for f in fields(cls) if f.metadata.get("static")]

    def flatten(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        return tuple(getattr(tree, n) for n in names), tuple(getattr(tree, n) for n in static)

    def flatten_with_keys(tree: Any) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        children, structure = flatten(tree)
        keys = (jax.tree_util.GetAttrKey(n) for n in names)
        return tuple(zip(keys, children, strict=True)), structure

    def unflatten(structure: tuple[Any, ...], children: Any) -> Any:
        tree = object.__new__(cls)
        for name, value in zip((*names, *static), (*children, *structure), strict=True):
            object.__setattr__(tree, name, value)
        return tree

    jax.tree_util.register_pytree_with_keys(cls, flatten_with_keys, unflatten, flatten)
    return cls
