"""Points of a reference surface: samples of its triangles, and those that cameras have seen."""

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int

from sfgs_jax.arrays import InputError, checked, require_least
from sfgs_jax.geometry import Camera


@checked
def sample_triangles(
    vertices: Float[np.ndarray, "n 3"], triangles: Int[np.ndarray, "m 3"], count: int, *, seed: int = 0
) -> Float[np.ndarray, "count 3"]:
    """Points spread uniformly over triangles, by area.

    The same seed gives the same points. They are about `sqrt(area / count)` apart, for example 1.4 cm for
    500,000 points on 100 m². Distances between two samplings of one surface are about half of that.

    Args:
        vertices: corners, metres.
        triangles: indices of the corners.
        count: number of points.
        seed: of the random numbers.

    Raises:
        InputError: there is no triangle with an area, or one has a corner that is not there; or the count or
            the seed is negative.
    """
    require_least(count, 0, "count of sample_triangles")
    require_least(seed, 0, "seed of sample_triangles")
    if len(triangles) and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
        raise InputError(f"triangles of sample_triangles should be indices of its {len(vertices)} vertices.")
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    if not mesh.area > 0:
        raise InputError(f"A surface of {len(triangles)} triangles without an area can't be sampled.")
    return np.asarray(trimesh.sample.sample_surface(mesh, count, seed=seed)[0], np.float64)


@checked
def seen_points(
    points: Float[np.ndarray, "n 3"],
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    T_world_cam: Float[np.ndarray, "4 4"],
    *,
    tolerance: float = 0.02,
) -> Bool[np.ndarray, " n"]:
    """Which points a depth image shows: those within the tolerance of the depth of their pixel.

    Surfaces that no image shows can't be reconstructed, so a reference is best cut down to those that some
    image shows. The tolerance also covers how depth changes within a pixel.

    Args:
        points: world coordinates, metres.
        depth: metres along z, 0 where missing.
        camera: intrinsics of the image.
        T_world_cam: pose of the camera.
        tolerance: metres.
    """
    x, y, z = ((points - T_world_cam[:3, 3]) @ T_world_cam[:3, :3]).T
    front = z > 1e-6
    safe = np.where(front, z, 1)
    u = np.rint(float(camera.fx) * x / safe + float(camera.cx))
    v = np.rint(float(camera.fy) * y / safe + float(camera.cy))
    inside = front & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    column, row = np.where(inside, u, 0).astype(np.int64), np.where(inside, v, 0).astype(np.int64)
    shown = depth[row, column]
    return inside & (shown > 0) & (np.abs(shown - z) < tolerance)
