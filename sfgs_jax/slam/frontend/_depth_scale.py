"""Does a frame measure depth in the unit of the frame that it was registered to?

A sensor whose scale of depth changes in mid-run moves every pose after the change, and each pose fits as well
as ever. But no pose lays two frames of different scales on each other. Their surfaces have different sizes,
and keypoints move in the image as no pose moves them. One more unknown beside the pose tells by how much: the
logarithm of the ratio of the two scales.
"""

import jax.numpy as jnp
import jaxlie
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Bool, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import dot, gauss_jordan
from sfgs_jax.slam.frontend._registration_rows import keypoint_rows, surface_rows
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import FeatureRegistration
from sfgs_jax.slam.state._tracker import TrackerParams

_SIGMAS = 3.0
"""Standard deviations by which a change of scale must be known."""

Number = Float[Array, ""] | float


def is_other_scale(change: Number, sigma: Number, limit: float) -> Bool[Array, ""] | bool:
    """True if a scale of depth is certainly another.

    Args:
        change: of the logarithm of the scale.
        sigma: its standard deviation.
        limit: largest change that is the sensor's distortion.
    """
    size = abs(change)
    return (size > limit) & (size > _SIGMAS * sigma)


def is_same_scale(change: Number, sigma: Number, limit: float) -> Bool[Array, ""] | bool:
    """True if a scale of depth is certainly the same: a change would have to be under half of the limit.

    Arguments as of `is_other_scale`.
    """
    return abs(change) + _SIGMAS * sigma < limit / 2


def depth_scale_change(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    T_target_source: jaxlie.SE3,
    matched: FeatureRegistration,
    moving: gicp.RowMotion | None = None,
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Logarithm of the target's scale of depth over the source's, and its standard deviation.

    One Gauss-Newton step from the motion, for pose and scale together. Robust weights hide a part of a large
    change: some four fifths of it are found.

    Args:
        params: parameters of tracking.
        source: the frame that was registered; its keypoints' depth is that of colour's time.
        target: the frame that it was registered to, rectified.
        T_target_source: the motion.
        matched: matches of the keypoints.
        moving: motion of the source while it was read; None where it stood still or is rectified.
    """
    config, total = params.config, jnp.zeros((8, 8))
    if config.use_surface:
        surface = surface_rows(params, source, target, T_target_source, moving)
        by_scale = dot(surface.points, surface.normals)
        total += _normal_matrix(surface.pose, by_scale, surface.residual, surface.weight)
    if config.features.kind != "none":
        rows = keypoint_rows(params, source, target, T_target_source, matched, moving)
        depth = source.keypoints.depth
        measured = jnp.where(depth > 0, 1 / jnp.where(depth > 0, depth, 1), 0)
        # Only what the source measured moves with its scale, which is inverse depth.
        by_scale = -(rows.by_measured * measured[None]).reshape(-1)
        total += _normal_matrix(rows.pose, by_scale, rows.residual, rows.weights)
    # Scaled before it is factorised, for float32; a pose that nothing fixes takes nothing away.
    scale = lax.rsqrt(jnp.maximum(jnp.diagonal(total), 1e-12))
    total = total * scale[:, None] * scale[None, :]
    _, taken = gauss_jordan(total[:6] + 1e-5 * jnp.eye(6, len(total), dtype=total.dtype))
    left = total[6:, 6:] - jnp.matmul(total[6:, :6], taken, precision=Precision.HIGHEST)
    information = jnp.maximum(left[0, 0], 1e-6)
    return -left[0, 1] / information * scale[6] / scale[7], lax.rsqrt(information) * scale[6]


def _normal_matrix(
    pose: Float[Array, "6 N"],
    by_scale: Float[Array, " N"],
    residual: Float[Array, " N"],
    weight: Float[Array, " N"],
) -> Float[Array, "8 8"]:
    columns = jnp.concatenate([pose, by_scale[None], residual[None]])
    columns = jnp.where(weight[None] > 0, columns, 0)
    return jnp.matmul(columns * weight[None], columns.T, precision=Precision.HIGHEST)
