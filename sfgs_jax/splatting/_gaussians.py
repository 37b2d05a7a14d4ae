"""Gaussians of fixed capacity, and the list of their parameters."""

from collections.abc import Mapping
from types import MappingProxyType

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import InputError, Text, described, printed_count, printed_fields
from sfgs_jax.geometry import Camera, require_camera

GAUSSIAN_PARAMETERS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        "means": (3,),
        "quaternions": (4,),
        "log_scales": (3,),
        "opacity_logits": (),
        "sh": (1, 3),
    }
)
"""Fields of `Gaussians` that are optimised, with one Gaussian's shape of each at harmonics of degree 0."""


class Gaussians(eqx.Module):
    """N slots for 3-D Gaussians; those that are `valid` are in use.

    The other slots may hold anything, NaN included: they change no rendering and no gradient.

    `jax.grad` by a whole `Gaussians` needs `allow_int=True`: the mask `valid` gets the empty gradient float0.
    With `equinox.filter_grad` the gradient is a `Gaussians` whose `valid` is None, as
    `equinox.apply_updates` takes it.

    Attributes:
        means: (N, 3) centres, world coordinates, metres.
        quaternions: (N, 4) wxyz, rotations from the Gaussian's axes to the world's. Their length has no
            influence; zero does not rotate.
        log_scales: (N, 3) logarithms of the standard deviations along the Gaussian's axes, metres.
        opacity_logits: (N,) opacities before the sigmoid.
        sh: (N, K, 3) spherical-harmonics coefficients of RGB, K = (degree + 1)², degree 0 to 3.
        valid: (N,) which slots are in use.
    """

    means: Float[Array, "n 3"]
    quaternions: Float[Array, "n 4"]
    log_scales: Float[Array, "n 3"]
    opacity_logits: Float[Array, " n"]
    sh: Float[Array, "n k 3"]
    valid: Bool[Array, " n"]

    def __repr__(self) -> str:
        return printed_fields("Gaussians", valid=Text(printed_count(self.valid)), sh=self.sh)


def require_scene(gaussians: Gaussians, camera: Camera) -> None:
    """Refuse a map or a camera that is something else.

    Raises:
        InputError: one of them is of another type.
    """
    if not isinstance(gaussians, Gaussians):
        raise InputError(f"The gaussians are a Gaussians, as from load_ply, not {described(gaussians)}.")
    require_camera(camera)


def valid_arrays(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Parameters of the valid Gaussians by name, float32 on the host; quaternions of unit length."""
    valid = np.asarray(gaussians.valid)
    arrays = {name: np.asarray(getattr(gaussians, name), np.float32)[valid] for name in GAUSSIAN_PARAMETERS}
    length = np.linalg.norm(arrays["quaternions"], axis=1, keepdims=True)
    unit = arrays["quaternions"] / np.where(length > 0, length, 1)
    arrays["quaternions"] = np.where(length > 0, unit, np.asarray([1, 0, 0, 0], np.float32))
    return arrays
