"""The map: Gaussians of fixed capacity with the moments of their optimiser."""

from dataclasses import replace
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import doubled
from sfgs_jax.geometry import se3
from sfgs_jax.splatting import GAUSSIAN_PARAMETERS, Gaussians

Parameters = dict[str, Array]
"""The optimised fields of `Gaussians` by name."""


_LEAST_ROOM = 128
"""Keyframes that the program of `move` has room for at first. It doubles, so that few need a new one."""


class GaussianMap(eqx.Module):
    """Gaussians and what Adam remembers about each.

    Attributes:
        gaussians: the map, (N,) slots of which `valid` ones are in use.
        first_moment: Adam's mean gradient of each parameter.
        second_moment: Adam's mean squared gradient of each parameter.
        updates: (N,) optimisation steps in which each Gaussian was seen.
        keyframes: (N,) number of the keyframe that each Gaussian belongs to and moves with.
    """

    gaussians: Gaussians
    first_moment: Parameters
    second_moment: Parameters
    updates: Float[Array, " n"]
    keyframes: Int[Array, " n"]


Slots = TypeVar("Slots", GaussianMap, Gaussians)


def parameters(gaussians: Gaussians) -> Parameters:
    """The optimised fields by name."""
    return {name: getattr(gaussians, name) for name in GAUSSIAN_PARAMETERS}


def with_parameters(gaussians: Gaussians, values: Parameters) -> Gaussians:
    """`gaussians` with its optimised fields replaced."""
    return Gaussians(**values, valid=gaussians.valid)


def empty_map(capacity: int) -> GaussianMap:
    """A map with room for `capacity` Gaussians and none in it."""
    dtype = jnp.result_type(float)
    # Made on the host: there, no shape needs a program of its own.
    zeros = jax.device_put(
        {name: np.zeros((capacity, *shape), dtype) for name, shape in GAUSSIAN_PARAMETERS.items()}
    )
    # Unused slots hold a unit quaternion and a unit scale: finite through every expression.
    identity = np.tile(np.eye(1, 4, dtype=dtype), (capacity, 1))
    start = zeros | {"quaternions": jax.device_put(identity)}
    return GaussianMap(
        gaussians=Gaussians(**start, valid=jax.device_put(np.zeros(capacity, bool))),
        first_moment=zeros,
        second_moment=zeros,
        updates=jax.device_put(np.zeros(capacity, dtype)),
        keyframes=jax.device_put(np.zeros(capacity, np.int32)),
    )


def at_rows(slots: Slots, rows: Int[Array, " v"]) -> Slots:
    """The same of some Gaussians alone.

    Args:
        slots: a map of N slots, or its Gaussians.
        rows: (v,) slots to take; N gives a slot that is not in use.
    """
    return jax.tree.map(lambda x: x.at[rows].get(mode="fill", fill_value=0), slots)


@jax.jit
def with_rows(gaussian_map: GaussianMap, rows: Int[Array, " v"], new: GaussianMap) -> GaussianMap:
    """The map after an optimiser's step on some Gaussians.

    Args:
        gaussian_map: before, N slots.
        rows: (v,) their slots in ascending order, each once; what lies at N is left out.
        new: `at_rows` of them after the step. What a step does not change is not taken from it.
    """

    def put(old: Array, values: Array) -> Array:
        return old.at[rows].set(values, mode="drop", indices_are_sorted=True, unique_indices=True)

    def stepped(m: GaussianMap) -> tuple[Parameters, Parameters, Parameters, Array]:
        return parameters(m.gaussians), m.first_moment, m.second_moment, m.updates

    values, first, second, updates = jax.tree.map(put, stepped(gaussian_map), stepped(new))
    gaussians = with_parameters(gaussian_map.gaussians, values)
    return replace(
        gaussian_map, gaussians=gaussians, first_moment=first, second_moment=second, updates=updates
    )


def grow(gaussian_map: GaussianMap) -> GaussianMap:
    """The same map with twice the room; programs over it compile anew."""
    room = empty_map(gaussian_map.gaussians.valid.shape[0])
    return jax.tree.map(lambda used, free: jnp.concatenate([used, free]), gaussian_map, room)


def move(
    gaussian_map: GaussianMap, old: Float[np.ndarray, "k 7"], new: Float[np.ndarray, "k 7"]
) -> GaussianMap:
    """The map after its keyframes have moved, each Gaussian with its own.

    Args:
        gaussian_map: the map.
        old: (k, 7) `T_world_cam` of the keyframes as wxyz_xyz, before.
        new: the same after.
    """
    room = keyframe_room(len(old)) - len(old)
    padded = (np.pad(poses, ((0, room), (0, 0)), mode="edge") for poses in (old, new))
    return _move(gaussian_map, *padded)


def keyframe_room(count: int) -> int:
    """Keyframes that the program of `move` has room for; one program for each value.

    Args:
        count: of keyframes that move.
    """
    return doubled(_LEAST_ROOM, count)


@jax.jit
def _move(gaussian_map: GaussianMap, old: Float[Array, "k 7"], new: Float[Array, "k 7"]) -> GaussianMap:
    moved = se3.compose(jaxlie.SE3(new), se3.inverse(jaxlie.SE3(old)))
    T = jaxlie.SE3(moved.wxyz_xyz[gaussian_map.keyframes])
    gaussians = gaussian_map.gaussians
    rotation = se3.rotation_matrix(T)
    means = (
        jnp.einsum("nij,nj->ni", rotation, gaussians.means, precision=Precision.HIGHEST) + T.wxyz_xyz[:, 4:]
    )
    return eqx.tree_at(
        lambda m: (m.gaussians.means, m.gaussians.quaternions),
        gaussian_map,
        (means, se3.quaternion_product(T.wxyz_xyz[:, :4], gaussians.quaternions)),
    )
