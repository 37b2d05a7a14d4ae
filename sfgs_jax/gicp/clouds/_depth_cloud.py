"""Organised clouds: the surface of a depth image at several resolutions."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from sfgs_jax.arrays import InputError, checked_but
from sfgs_jax.geometry import (
    Camera,
    clean_depth,
    downscale_depth,
    require_camera,
    require_depth,
    surface,
    warn_unless_metres,
)
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


@checked_but("depth", "camera")
def prepare(
    depth: Shaped[Array | np.ndarray, "..."], camera: Camera, *, config: GicpConfig | None = None
) -> OrganisedCloud:
    """Organised cloud of a depth image, ready to be source or target of `align`.

    Warns if the median of a NumPy image is no distance in metres.

    Args:
        depth: (H, W) float32 metres along z; anything not finite or not positive is missing.
        camera: intrinsics of the depth image.
        config: settings, `GicpConfig()` if not given.

    Raises:
        InputError: `depth` is no floating-point image of the camera's size, or is too small for the levels.
    """
    config = GicpConfig() if config is None else config
    require_camera(camera)
    require_depth(depth, camera.shape, "The depth image", "its camera's")
    if isinstance(depth, np.ndarray):
        warn_unless_metres(depth)
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
