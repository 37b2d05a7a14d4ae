"""Images of a moving camera whose rows are exposed one after the other."""

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.datasets.synthetic._raycast import Hits, cast_rows
from sfgs_jax.datasets.synthetic._render import LANES, shade, unit_normals
from sfgs_jax.datasets.synthetic._scene import Scene
from sfgs_jax.geometry import Camera, se3


@jax.jit
def colour_by_rows(
    scene: Scene, camera: Camera, T_world_centre: jaxlie.SE3, T_world_corner: jaxlie.SE3
) -> Float[Array, "h w 3"]:
    """Colour as the mean of k instants, averaged over each pixel's centre and corners as by `render_view`.

    Corners lie between two rows, and are seen between the two rows' times.

    Args:
        scene: the triangles.
        camera: intrinsics of the image.
        T_world_centre: (k, h) poses at the times of rows 0, ..., h - 1, at each instant.
        T_world_corner: (k, h + 1) poses at the times of rows -0.5, ..., h - 0.5.
    """
    height, width = camera.shape
    centre_rows, corner_rows = (jnp.arange(n, dtype=jnp.float32) for n in (height, height + 1))
    rows = jnp.concatenate([centre_rows, corner_rows - 0.5])
    first_column = jnp.where(jnp.arange(2 * height + 1) < height, 0, jnp.float32(-0.5))
    columns = first_column[:, None] + jnp.arange(_padded(width + 1), dtype=jnp.float32)[None]
    pixels = jnp.stack([columns, jnp.broadcast_to(rows[:, None], columns.shape)], axis=-1)

    def at_instant(total: Array, poses: tuple[jaxlie.SE3, jaxlie.SE3]) -> tuple[Array, None]:
        T_world_row = jax.tree.map(lambda *both: jnp.concatenate(both), *poses)
        rgb, _, _ = _shaded_rows(scene, camera, T_world_row, pixels)
        corner = rgb[height:, : width + 1]
        corners = (corner[:-1, :-1] + corner[:-1, 1:] + corner[1:, :-1] + corner[1:, 1:]) / 4
        return total + (rgb[:height, :width] + corners) / 2, None

    instants = len(T_world_centre.wxyz_xyz)
    black = jnp.zeros((height, width, 3), jnp.float32)
    total, _ = jax.lax.scan(at_instant, black, (T_world_centre, T_world_corner))
    return total / instants


@jax.jit
def depth_by_rows(
    scene: Scene, camera: Camera, T_world_row: jaxlie.SE3
) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
    """Depth at pixel centres.

    Args:
        scene: the triangles.
        camera: intrinsics of the image.
        T_world_row: (h,) poses at the times of the rows.

    Returns:
        Metres along z of each row's own camera, 0 if there is no surface; and the cosine between the
        surface's normal and the ray back to the camera.
    """
    width = camera.width
    pixels = jnp.pad(camera.pixels(), ((0, 0), (0, _padded(width) - width), (0, 0)), mode="edge")
    _, depth, facing = _shaded_rows(scene, camera, T_world_row, pixels)
    return depth[:, :width], facing[:, :width]


def _padded(width: int) -> int:
    return width + -width % LANES


def _shaded_rows(
    scene: Scene, camera: Camera, T_world_row: jaxlie.SE3, pixels: Float[Array, "r n 2"]
) -> tuple[Float[Array, "r n 3"], Float[Array, "r n"], Float[Array, "r n"]]:
    """Colour, depth and facing of rows of rays with a pose each."""
    hits = cast_rows(scene.triangles, camera, T_world_row, pixels)
    world_normals = unit_normals(scene.triangles)

    def shaded(pose: jaxlie.SE3, pixels: Array, hits: Hits) -> tuple[Array, Array]:
        to_camera = se3.rotation_matrix(pose)
        normals = jnp.matmul(world_normals, to_camera, precision=jax.lax.Precision.HIGHEST)
        return shade(scene, normals, camera, pose, pixels, hits)

    rgb, facing = jax.vmap(shaded)(T_world_row, pixels, hits)
    return rgb, hits.depth, facing
