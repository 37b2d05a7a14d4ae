"""Visibility: which Gaussians a camera sees, and which lie behind a surface."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting._binning import Occluder, are_hidden
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting._projection import Projected, project

_DEVIATIONS = 3.0
"""Standard deviations to which a Gaussian reaches towards the camera, at most."""


@checked
def in_sight(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: se3.Pose,
    *,
    shutter: RollingShutter | None = None,
    hidden_beyond: Float[Array, "H W"] | None = None,
    config: RenderConfig = DEFAULT,
) -> Bool[Array, " n"]:
    """Mask of the Gaussians that `render` draws with these arguments.

    Rendering these alone gives the same images, in the time that their number takes. Gaussians larger than a
    tile count as in sight where the surface hides them.

    Args:
        gaussians: the map.
        camera: intrinsics and image size.
        T_world_cam: pose of the camera, `jaxlie.SE3` or a homogeneous 4 x 4 matrix.
        shutter: as of `render`.
        hidden_beyond: as of `render`.
        config: settings, static; as of `project`, and `tile_size`.

    Raises:
        InputError: the harmonics are not of degree 0 to 3, or the pose is none.
    """
    pose = se3.as_se3(T_world_cam, name="T_world_cam")
    return _in_sight(gaussians, camera, pose, shutter, hidden_beyond, config)


@partial(jax.jit, static_argnames="config")
def _in_sight(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    shutter: RollingShutter | None,
    hidden_beyond: Float[Array, "H W"] | None,
    config: RenderConfig,
) -> Bool[Array, " n"]:
    projected, _ = project(gaussians, camera, T_world_cam, shutter, config=config)
    if hidden_beyond is None:
        return projected.visible
    occluder = occluder_of(gaussians, projected, hidden_beyond)
    size = {"width": camera.width, "height": camera.height, "tile_size": config.tile_size}
    return projected.visible & ~are_hidden(projected, occluder, **size)


def occluder_of(gaussians: Gaussians, projected: Projected, beyond: Float[Array, "H W"]) -> Occluder:
    """The surface before some Gaussians.

    Args:
        gaussians: N Gaussians.
        projected: their images.
        beyond: (H, W) depth of the surface along z, metres; 0 where it is unknown.
    """
    reach = _DEVIATIONS * jnp.exp(jnp.max(gaussians.log_scales, axis=1))
    return Occluder(projected.depths - reach, beyond)
