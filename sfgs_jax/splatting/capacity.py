"""How much room a view needs, found on the host before rendering it."""

import equinox as eqx
import jaxlie
from jaxtyping import Array

from sfgs_jax.geometry import Camera
from sfgs_jax.splatting.binning import count_pairs, count_rows
from sfgs_jax.splatting.config import DEFAULT, RenderConfig
from sfgs_jax.splatting.gaussians import Gaussians
from sfgs_jax.splatting.projection import Projected, project

_SMALLEST = 1024


def pair_capacity(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    *,
    config: RenderConfig = DEFAULT,
    headroom: float = 1.0,
) -> int:
    """A `RenderConfig.pair_capacity` with room for a view, as a Python integer; not for use under jit.

    Args:
        gaussians: the map.
        camera: intrinsics and image size.
        T_world_cam: pose of the camera.
        config: settings; its own `pair_capacity` has no influence.
        headroom: factor on the need, for views and steps that come.

    Returns:
        The need rounded up to 1024 times a power of two or one and a half of it, so that a driver that
        grows meets few sizes and compiles few programs.
    """
    if gaussians.means.shape[0] == 0:
        return rounded_capacity(0)
    projected, rows = _project_and_count(gaussians, camera, T_world_cam, config)
    pairs = _count(projected, camera.width, camera.height, config.tile_size, rounded_capacity(int(rows)))
    return rounded_capacity(int(headroom * max(int(rows), int(pairs))))


def rounded_capacity(need: int) -> int:
    """The least of 1024, 1536, 2048, 3072, 4096, ... that is not below `need`."""
    capacity = _SMALLEST
    while capacity < need:
        if capacity + capacity // 2 >= need:
            return capacity + capacity // 2
        capacity *= 2
    return capacity


@eqx.filter_jit
def _project_and_count(
    gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, config: RenderConfig
) -> tuple[Projected, Array]:
    projected, _ = project(gaussians, camera, T_world_cam, config=config)
    return projected, count_rows(projected, height=camera.height, tile_size=config.tile_size)


@eqx.filter_jit
def _count(projected: Projected, width: int, height: int, tile_size: int, row_capacity: int) -> Array:
    return count_pairs(projected, width=width, height=height, tile_size=tile_size, row_capacity=row_capacity)
