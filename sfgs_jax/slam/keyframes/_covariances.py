"""Covariances of poses: of a registration, and of keyframes in the world."""

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._keyframe_graph import EdgeNoise
from sfgs_jax.slam.state._registration import BY_KEYPOINTS, Registration


def motion_covariance(found: Registration, noise: EdgeNoise, free_sigma: float) -> Float[np.ndarray, "6 6"]:
    """Covariance of the tangent of a registration's motion.

    Args:
        found: the registration.
        noise: of the registrations of the run.
        free_sigma: standard deviation where nothing but the motion model tells, metres and radians.
    """
    told = np.asarray(found.surface_information, np.float64)
    if int(found.source) in BY_KEYPOINTS:
        told = told + np.asarray(found.matched.information)
    # Along directions that nothing observes, the rounding of float32 may leave less than none.
    values, directions = np.linalg.eigh((told + told.T) / 2)
    known = (directions / (np.maximum(values, 0) + free_sigma**-2)) @ directions.T
    return known + noise.covariance


def best_known(covariances: Float[np.ndarray, "w 6 6"]) -> int:
    """Number of the pose whose position is known best.

    Args:
        covariances: of the poses.
    """
    return int(np.argmin(np.trace(covariances[:, :3, :3], axis1=1, axis2=2)))


def covariances_in_world(
    found: Float[np.ndarray, "w 6 6"],
    poses: Float[np.ndarray, "w 7"],
    before: Float[np.ndarray, "w 6 6"],
    anchor: int,
) -> Float[np.ndarray, "w 6 6"]:
    """Covariances of keyframes after an adjustment.

    No keyframe is known better than the anchor is. A keyframe keeps its former covariance if that is smaller:
    then keyframes that took no part had told more.

    Args:
        found: as if the anchor were known.
        poses: `T_world_cam` of the keyframes as wxyz_xyz.
        before: covariances before the adjustment.
        anchor: number of the anchor.
    """
    at = se3.matrices_of(poses)
    known = np.broadcast_to(before[anchor], found.shape)
    after = se3.composed_covariances(known, np.linalg.inv(at[anchor]) @ at, found)
    if not before[anchor].any():
        return after  # the anchor is the world frame, and nobody is outside who could know more
    position = [np.trace(c[:, :3, :3], axis1=1, axis2=2) for c in (before, after)]
    return np.where((position[0] < position[1])[:, None, None], before, after)
