"""Colour behind a map by direction, for what a camera sees where the map has nothing.

It is the same from everywhere: an environment map in spherical harmonics of degree 2, nine coefficients a
channel.

Source: Ramamoorthi and Hanrahan, An efficient representation for irradiance environment maps, SIGGRAPH 2001.
"""

from collections.abc import Iterable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting._rendering import RenderOutput
from sfgs_jax.splatting._spherical_harmonics import sh_basis

COEFFICIENTS = 9
_OPAQUE = 0.5
"""Opacity from which on a map hides the background. Its colours were fitted without one."""
_RIDGE = 0.01
"""Weight of a background of one colour, as a share of the pixels: directions that were not seen have it."""


@checked
def fitted_background(
    images: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray]], camera: Camera
) -> Float[np.ndarray, "9 3"]:
    """Coefficients of the colours that images show by direction, by linear least squares.

    Args:
        images: of each the colours (H, W, 3), which of its pixels hold one (H, W), and `T_world_cam` (4, 4).
        camera: intrinsics of all of them.

    Raises:
        InputError: no pixel holds a colour.
    """
    information, right = np.zeros((COEFFICIENTS, COEFFICIENTS)), np.zeros((COEFFICIENTS, 3))
    for rgb, valid, T_world_cam in images:
        a, b = _equations(jnp.asarray(rgb), jnp.asarray(valid), camera, jnp.asarray(T_world_cam))
        information += np.asarray(a)
        right += np.asarray(b)
    if information[0, 0] == 0:
        raise InputError("No pixel of the images holds a colour, so there is no background to fit.")
    beyond_mean = np.arange(COEFFICIENTS) > 0
    information[beyond_mean, beyond_mean] += _RIDGE * information[0, 0]
    return np.linalg.solve(information, right)


@jax.jit
def with_background(
    output: RenderOutput, background: Float[Array, "9 3"], camera: Camera, T_world_cam: se3.Pose
) -> RenderOutput:
    """A rendering whose colours lie over the background where the map is less than half opaque.

    At an opacity of one half nothing of the background shows. A map that was fitted without one makes up in
    its colours for what it lacks in opacity.

    Args:
        output: rendering without a background.
        background: (9, 3) coefficients; see `fitted_background`.
        camera: intrinsics of the rendering.
        T_world_cam: its pose.
    """
    colours = 0.5 + jnp.einsum(
        "hwk,kc->hwc", _basis(camera, T_world_cam), background, precision=Precision.HIGHEST
    )
    share = jnp.clip(1 - output.alpha / _OPAQUE, 0, 1)[..., None]
    return replace(output, rgb=output.rgb + share * jnp.clip(colours, 0, 1))


@jax.jit
def _equations(
    rgb: Float[Array, "H W 3"], valid: Bool[Array, "H W"], camera: Camera, T_world_cam: Float[Array, "4 4"]
) -> tuple[Float[Array, "9 9"], Float[Array, "9 3"]]:
    """Normal equations of one image."""
    basis = _basis(camera, T_world_cam)
    weighted = jnp.where(valid[..., None], basis, 0)
    return (
        jnp.einsum("hwj,hwk->jk", weighted, basis, precision=Precision.HIGHEST),
        jnp.einsum("hwj,hwc->jc", weighted, rgb - 0.5, precision=Precision.HIGHEST),
    )


def _basis(camera: Camera, T_world_cam: se3.Pose) -> Float[Array, "H W 9"]:
    """Spherical harmonics at each pixel's direction in the world."""
    rays = camera.unproject(camera.pixels(), jnp.ones(camera.shape, camera.fx.dtype)).reshape(-1, 3)
    rays = rays / jnp.linalg.norm(rays, axis=-1, keepdims=True)
    R = se3.rotation_matrix(se3.as_se3(T_world_cam, name="T_world_cam"))
    directions = jnp.matmul(rays, R.T, precision=Precision.HIGHEST)
    return sh_basis(directions, COEFFICIENTS).reshape(*camera.shape, COEFFICIENTS)
