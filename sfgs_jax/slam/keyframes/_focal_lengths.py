"""Equation of the focal lengths after a registration of two keyframes.

Wrong focal lengths stretch what is seen across the image, and no motion lays two views of it on each other.
Residuals hardly show that: the best motion hides most of it, and the poses drift. With one more unknown
beside the pose, each registration tells how wrong the focal lengths are. They are the same for all frames, so
that the sum of what registrations tell is all there is to keep.

Only keypoints are asked. A distortion of depth bends surfaces as wrong focal lengths do.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.frontend._registration_rows import keypoint_rows
from sfgs_jax.slam.keyframes._elimination import without_pose
from sfgs_jax.slam.state._focal_information import FocalInformation
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import TrackerParams


def focal_lengths_by(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    found: Registration,
) -> FocalInformation:
    """What one registration says about the focal lengths.

    Args:
        params: parameters of tracking; their camera has the focal lengths in use.
        source: the frame that was registered.
        target: the frame that it was registered to.
        found: the registration, by keypoints.
    """
    matrix = np.asarray(_normal_matrix(params, source, target, found), np.float64)
    left = without_pose(matrix)
    return FocalInformation.of(information=float(left[0, 0]), vector=-float(left[0, 1]))


@jax.jit
def _normal_matrix(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> Float[Array, "8 8"]:
    """Normal matrix of the pose, the logarithm of the focal lengths, and the residual."""
    T, matched = found.T_target_source, found.matched
    rows = keypoint_rows(params, source, target, T, matched)
    # Longer focal lengths bring a pixel's point nearer to the optical axis, and move a point's pixel out.
    # That is as if the point had moved by this.
    across = jnp.asarray([[1], [1], [0]], rows.points.dtype)
    measured = across * target.keypoints.points[matched.index].T
    back = se3.rotation_matrix(T).T
    moved = across * rows.points - jnp.matmul(back, measured, precision=Precision.HIGHEST)
    columns = jnp.concatenate([rows.pose, rows.by_points(moved)[None], rows.residual[None]])
    columns = jnp.where(rows.weights[None] > 0, columns, 0)
    return jnp.matmul(columns * rows.weights[None], columns.T, precision=Precision.HIGHEST)
