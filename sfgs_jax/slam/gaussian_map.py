"""The map: Gaussians of fixed capacity with the moments of their optimiser."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.splatting import Gaussians

Parameters = dict[str, Array]
"""The optimised fields of `Gaussians` by name."""

PARAMETER_SHAPES = {
    "means": (3,),
    "quaternions": (4,),
    "log_scales": (3,),
    "opacity_logits": (),
    "sh": (1, 3),
}


class GaussianMap(eqx.Module):
    """Gaussians and what Adam remembers about each.

    Attributes:
        gaussians: the map, (N,) slots of which `valid` ones are in use.
        first_moment: Adam's mean gradient of each parameter.
        second_moment: Adam's mean squared gradient of each parameter.
        updates: (N,) optimisation steps in which each Gaussian was seen.
    """

    gaussians: Gaussians
    first_moment: Parameters
    second_moment: Parameters
    updates: Float[Array, " n"]


def parameters(gaussians: Gaussians) -> Parameters:
    """The optimised fields by name."""
    return {name: getattr(gaussians, name) for name in PARAMETER_SHAPES}


def with_parameters(gaussians: Gaussians, values: Parameters) -> Gaussians:
    """`gaussians` with its optimised fields replaced."""
    return Gaussians(**values, valid=gaussians.valid)


def empty_map(capacity: int) -> GaussianMap:
    """A map with room for `capacity` Gaussians and none in it."""
    zeros = {name: jnp.zeros((capacity, *shape)) for name, shape in PARAMETER_SHAPES.items()}
    # Unused slots hold a unit quaternion and a unit scale: finite through every expression.
    start = zeros | {"quaternions": zeros["quaternions"].at[:, 0].set(1.0)}
    return GaussianMap(
        gaussians=Gaussians(**start, valid=jnp.zeros(capacity, bool)),
        first_moment=zeros,
        second_moment=zeros,
        updates=jnp.zeros(capacity),
    )


def grow(gaussian_map: GaussianMap) -> GaussianMap:
    """The same map with twice the room; programs over it compile anew."""
    room = empty_map(gaussian_map.gaussians.valid.shape[0])
    return jax.tree.map(lambda used, free: jnp.concatenate([used, free]), gaussian_map, room)
