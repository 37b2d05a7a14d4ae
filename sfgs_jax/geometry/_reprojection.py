"""RGB-D reprojection residual: pixel and inverse depth of points in a camera, with Jacobians in closed form.

The point p has its image at u = fx x / z + cx, v = fy y / z + cy, and the inverse depth 1 / z. Stereo and
structured light measure inverse depth with constant noise, so all three rows have constant deviations.

A point behind the camera, or nearer than `NEAREST_DEPTH`, has no image. Its residual is then constant: the
width of the image in both pixel rows, and 0 in the row of depth. Its Jacobians are 0. A step that takes a
point behind a camera pays for it, and nothing pulls on a point that is there already.

Arrays have their lanes last, (3, N), and are written as sums of elementwise products: XLA fuses these into
one loop along the lanes.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Bool, Float

from sfgs_jax.arrays import checked, multiply
from sfgs_jax.geometry._camera import Camera
from sfgs_jax.geometry._tangents import skew

NEAREST_DEPTH = 0.05
"""Metres along z below which a point has no image: no RGB-D camera measures nearer than 0.1 m, and at 0.05 m
a millimetre already moves the image by 10 pixels, too much for a linear model."""


class ReprojectionResiduals(eqx.Module):
    """Whitened reprojection residuals of N points, predicted minus measured, and their Jacobians.

    R is 3 (u, v, inverse depth), or 2 without depth.

    Attributes:
        residual: (R, N) standard deviations; (width, width, 0), whitened, where a point has no image.
        point_jacobian: (R, 3, N) by the point in camera coordinates; 0 where it has no image.
        pose_jacobian: (R, 6, N) by the tangent of T_world_cam (translation first, T_world_cam @ exp(delta)).
        has_image: (N,) points in front of the camera, at least `NEAREST_DEPTH` away.
    """

    residual: Float[Array, "R N"]
    point_jacobian: Float[Array, "R 3 N"]
    pose_jacobian: Float[Array, "R 6 N"]
    has_image: Bool[Array, " N"]


@checked
def reprojection_residuals(
    camera: Camera,
    points: Float[Array, "3 N"],
    pixels: Float[Array, "2 N"],
    depth: Float[Array, " N"] | None = None,
    *,
    sigma: Float[ArrayLike, ""] | Float[Array, " N"] = 1.0,
    inverse_depth_sigma: Float[ArrayLike, ""] | Float[Array, " N"] = 1.0,
) -> ReprojectionResiduals:
    """Reprojection residuals of points in camera coordinates.

    Args:
        camera: intrinsics.
        points: (3, N) in camera coordinates, metres.
        pixels: (2, N) measured (u, v).
        depth: (N,) measured metres along z; the third row is 0 where it is not positive or not finite.
            Without it there are two rows.
        sigma: (N,) or scalar standard deviation, pixels.
        inverse_depth_sigma: (N,) or scalar standard deviation of inverse depth, 1 / m.
    """
    has_image = points[2] > NEAREST_DEPTH
    # Replaced before anything is divided by it: neither values nor gradients may become NaN.
    x, y, z = jnp.where(has_image, points, jnp.asarray([[0], [0], [1]], points.dtype))
    inverse = 1 / z
    a, b, zero = x * inverse, y * inverse, jnp.zeros_like(x)
    # One for all points, or one for each.
    sigma = jnp.expand_dims(jnp.asarray(sigma), 0) if jnp.ndim(sigma) else sigma
    offset = jnp.stack([camera.fx * a + camera.cx, camera.fy * b + camera.cy]) - pixels
    rows = [jnp.where(has_image, offset, camera.width) / sigma]
    slopes = [
        jnp.stack([camera.fx * inverse, zero, -camera.fx * a * inverse]) / sigma,
        jnp.stack([zero, camera.fy * inverse, -camera.fy * b * inverse]) / sigma,
    ]
    if depth is not None:
        known = jnp.isfinite(depth) & (depth > 0)
        measured = 1 / jnp.where(known, depth, 1)
        beyond = jnp.where(has_image & known, inverse - measured, 0) / inverse_depth_sigma
        along = jnp.where(known, -(inverse**2), 0) / inverse_depth_sigma
        rows.append(beyond[None])
        slopes.append(jnp.stack([zero, zero, along]))
    at_point = jnp.where(has_image, jnp.stack(slopes), 0)
    # The point is R^T (X - t) in the camera, and moves by -d_translation + [p] d_rotation.
    at_pose = jnp.concatenate([-at_point, multiply(at_point, skew(jnp.stack([x, y, z])))], axis=1)
    return ReprojectionResiduals(jnp.concatenate(rows), at_point, at_pose, has_image)
