"""Organised clouds: the surface of a depth image at several resolutions."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, clean_depth, downscale_depth, surface
from sfgs_jax.gicp._config import GicpConfig


class OrganisedLevel(eqx.Module):
    """One resolution of an organised cloud.

    Attributes:
        surface: (H, W, 6) point and normal of each pixel, side by side, so that a gather copies both.
        valid: (H, W) whether the pixel has a surface.
        camera: intrinsics of this level.
    """

    surface: Float[Array, "H W 6"]
    valid: Bool[Array, "H W"]
    camera: Camera

    @property
    def points(self) -> Float[Array, "H W 3"]:
        """Camera coordinates, metres; 0 where not valid."""
        return self.surface[..., :3]

    @property
    def normals(self) -> Float[Array, "H W 3"]:
        """Unit normals facing the camera; 0 where not valid."""
        return self.surface[..., 3:]


class OrganisedCloud(eqx.Module):
    """Surface of a depth image at several resolutions.

    Attributes:
        levels: from the finest to the coarsest.
    """

    levels: tuple[OrganisedLevel, ...]


def prepare(
    depth: Float[Array | np.ndarray, "H W"], camera: Camera, *, config: GicpConfig | None = None
) -> OrganisedCloud:
    """Organised cloud of a depth image, ready to be source or target of `align`.

    Args:
        depth: metres along z; anything not finite or not positive is missing.
        camera: intrinsics of the depth image.
        config: settings, `GicpConfig()` if not given.

    Raises:
        InputError: `depth` does not have the camera's size, or is too small for the levels.
    """
    config = GicpConfig() if config is None else config
    if depth.shape != camera.shape:
        raise InputError(
            f"The depth image is {depth.shape}, but its camera is {camera.shape} (rows, columns)."
        )
    halvings = config.skipped_halvings + config.levels - 1
    if min(depth.shape) < 2 ** (halvings + 2):
        raise InputError(
            f"A depth image of {depth.shape} can't be halved {halvings} times; ask for fewer levels."
        )
    return _prepare(depth, camera, config)


@partial(jax.jit, static_argnames="config")
def _prepare(depth: Float[Array, "H W"], camera: Camera, config: GicpConfig) -> OrganisedCloud:
    depth, _ = clean_depth(depth)
    levels = []
    for halving in range(config.skipped_halvings + config.levels):
        if halving > 0:
            depth, camera = downscale_depth(depth, 2), camera.downscaled(2)
        if halving >= config.skipped_halvings:
            s = surface(depth, camera, radius=config.radius, edge_tolerance=config.edge_tolerance)
            levels.append(OrganisedLevel(jnp.concatenate([s.points, s.normals], axis=-1), s.valid, camera))
    return OrganisedCloud(tuple(levels))
