"""Dataclasses as pytrees: what is in the tree, what in its structure, what may stand in for arrays."""

from dataclasses import dataclass, field, replace

import jax
import jax.numpy as jnp
import pytest
from jaxtyping import Array, Float

from sfgs_jax.arrays import pytree


@pytree
@dataclass(frozen=True, eq=False)
class Reading:
    """Two arrays and what a program is compiled for."""

    near: Float[Array, " n"]
    far: Float[Array, " m"]
    sensor: str = field(metadata={"static": True})


READING = Reading(jnp.zeros(2), jnp.ones(3), "left")


def test_arrays_are_leaves_and_static_fields_structure(compilations):
    names = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(READING)]
    assert names == [".near", ".far"]
    length = jax.jit(lambda r: r.near.sum() + r.far.sum() + len(r.sensor))
    assert float(length(READING)) == 7
    other = replace(READING, near=jnp.ones(2))
    before = len(compilations)
    assert float(length(other)) == 9
    assert len(compilations) == before
    assert float(length(replace(READING, sensor="right"))) == 8
    assert len(compilations) == before + 1


def test_trees_are_put_together_of_anything():
    shapes = jax.tree.map(lambda x: x.shape, READING)
    assert (shapes.near, shapes.far, shapes.sensor) == ((2,), (3,), "left")
    gradient = jax.grad(lambda r: jnp.sum(r.near) + 2 * jnp.sum(r.far))(READING)
    assert list(gradient.far) == [2, 2, 2]


def test_fields_are_not_assigned():
    name = "near"
    with pytest.raises(AttributeError):
        setattr(READING, name, jnp.zeros(1))
