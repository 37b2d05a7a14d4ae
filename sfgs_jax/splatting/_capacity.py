"""Room that a view needs for its (tile, Gaussian) pairs, found on the host before rendering it."""

import math
from functools import partial

import jax
import jaxlie
from jaxtyping import Array, Int

from sfgs_jax.arrays import InputError, bucket, checked_but
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting._binning import count_pairs, count_rows
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians, require_scene
from sfgs_jax.splatting._projection import Projected, project

_SMALLEST = 1024
"""Least capacity."""


@checked_but("gaussians", "camera", "T_world_cam")
def pair_capacity(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: se3.Pose,
    *,
    config: RenderConfig = DEFAULT,
    headroom: float = 1.0,
) -> int:
    """Value for `RenderConfig.pair_capacity` with room for a view; not for use under jit.

    Args:
        gaussians: the map.
        camera: intrinsics and image size.
        T_world_cam: pose of the camera, `jaxlie.SE3` or a homogeneous 4 x 4 matrix.
        config: settings; its own `pair_capacity` has no influence.
        headroom: factor on the need, for later views and steps.

    Returns:
        The need rounded up to 1024, 1536, 2048, 3072, ...: a caller that grows meets few sizes and compiles
        few programs.

    Raises:
        InputError: an argument is of another type, the pose is none, or the headroom is below 0 or infinite.
    """
    require_scene(gaussians, camera)
    if not 0 <= headroom < math.inf:
        raise InputError(
            f"headroom of pair_capacity should be a finite factor of at least 0, not {headroom}."
        )
    pose = se3.as_se3(T_world_cam, name="T_world_cam")
    if gaussians.means.shape[0] == 0:
        return _room(0)
    projected, rows = _project_and_count(gaussians, camera, pose, config)
    pairs = _count(projected, camera.width, camera.height, config.tile_size, _room(int(rows)))
    return _room(int(headroom * max(int(rows), int(pairs))))


def _room(need: int) -> int:
    """Least of 1024, 1536, 2048, 3072, ... that is not below `need`."""
    return bucket(need, steps=2, smallest=_SMALLEST)


@partial(jax.jit, static_argnames="config")
def _project_and_count(
    gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, config: RenderConfig
) -> tuple[Projected, Int[Array, ""]]:
    projected, _ = project(gaussians, camera, T_world_cam, config=config)
    return projected, count_rows(projected, height=camera.height, tile_size=config.tile_size)


@partial(jax.jit, static_argnames=("width", "height", "tile_size", "row_capacity"))
def _count(
    projected: Projected, width: int, height: int, tile_size: int, row_capacity: int
) -> Int[Array, ""]:
    return count_pairs(projected, width=width, height=height, tile_size=tile_size, row_capacity=row_capacity)
