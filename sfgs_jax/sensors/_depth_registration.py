"""Depth whose camera is a little beside the place that its registration to colour assumes."""

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, dot
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors._depth_interpolation import interpolated_depth

_STEEPEST = 0.2
"""Least cosine between a ray and the normal that it meets. A pixel's width becomes five in depth there."""


def registered_depth(
    depth: Float[Array, "H W"], camera: Camera, tangent: Float[Array, "6"]
) -> Float[Array, "H W"]:
    """Depth as the colour camera would have seen it.

    Each ray takes the depth from where its surface was seen. That is found by the flow at the ray itself,
    which is smooth but for edges of depth, and right to a twentieth. Gradients reach the tangent.

    Args:
        depth: (H, W) metres along z of the depth camera, 0 where missing.
        camera: intrinsics of both.
        tangent: (6,) of T_colour_depth, metres and radians, at most a few centimetres and degrees.

    Returns:
        (H, W) metres along z of the colour camera; 0 where nothing was seen.
    """
    T, pixels, seen = se3.exp(tangent), camera.pixels().reshape(-1, 2).T, depth.reshape(-1)
    flow = _project(camera, _moved(T, camera, pixels, jnp.where(seen > 0, seen, 1))) - pixels
    there = pixels - flow
    found = jnp.where(seen > 0, interpolated_depth(depth, there), 0)
    known = found > 0
    points = _moved(T, camera, there, jnp.where(known, found, 1))
    # At an edge of depth another surface may lie there, and be seen elsewhere.
    off = jnp.abs(_project(camera, points) - pixels)
    known &= (off[0] < 1) & (off[1] < 1)
    return jnp.where(known, points[2], 0).reshape(depth.shape)


@checked
def depth_slopes(points: Float[Array, "3 K"], normals: Float[Array, "3 K"]) -> Float[Array, "6 K"]:
    """Relative change of depth along the rays of some points, by the tangent of T_colour_depth.

    The surface moves, and the ray meets it elsewhere.

    Args:
        points: (3, K) in the camera, metres.
        normals: (3, K) of their surface; what is no unit vector facing the camera counts as unknown, and the
            surface as square to the ray.
    """
    length = jnp.sqrt(dot(points, points))
    faces = dot(normals, points) < -_STEEPEST * length
    normals = jnp.where(faces[None], normals, -points)
    return se3.plane_jacobian(points, normals) / dot(normals, points)[None]


# Coordinates are rows here: XLA on CPU reads and writes them several times as fast as columns.


def _moved(
    T: jaxlie.SE3, camera: Camera, pixels: Float[Array, "2 N"], depth: Float[Array, " N"]
) -> Float[Array, "3 N"]:
    x, y = (pixels[0] - camera.cx) / camera.fx * depth, (pixels[1] - camera.cy) / camera.fy * depth
    R, t = se3.rotation_matrix(T), T.translation()
    return jnp.stack([R[i, 0] * x + R[i, 1] * y + R[i, 2] * depth + t[i] for i in range(3)])


def _project(camera: Camera, points: Float[Array, "3 N"]) -> Float[Array, "2 N"]:
    z = jnp.maximum(points[2], 1e-6)
    return jnp.stack([camera.fx * points[0] / z + camera.cx, camera.fy * points[1] / z + camera.cy])
