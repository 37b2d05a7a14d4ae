"""Relative pose of two calibrated cameras from matched points, and its error.

Source: the protocol of Yi et al., Learning to find good correspondences (CVPR 2018), as later work uses it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.arrays import checked, require_above_zero, require_least

_CONFIDENCE = 0.99999
# The five-point method needs five; with fewer matches there is no motion.
_FEWEST = 5
# OpenCV drops points further away than this many baselines when it chooses among the four motions of an
# essential matrix; far points are welcome.
_FURTHEST = 1e9


@dataclass(frozen=True)
class EstimatedMotion:
    """A motion from matches, up to the length of the translation.

    Attributes:
        R_b_a: rotation.
        direction: unit translation of `T_b_a`.
        inliers: mask of the matches that agree with the motion and lie in front of both cameras.
    """

    R_b_a: Float[np.ndarray, "3 3"]
    direction: Float[np.ndarray, "3"]
    inliers: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class PoseError:
    """Angular errors of an estimated motion, degrees; 180 where there is none.

    Attributes:
        rotation_deg: angle between estimated and true rotation.
        translation_deg: angle between estimated and true translation as lines, from 0 to 90. Their signs
            don't count, as is customary.
    """

    rotation_deg: float
    translation_deg: float

    @property
    def degrees(self) -> float:
        """The larger of the two angles, of which accuracies are taken."""
        return max(self.rotation_deg, self.translation_deg)


@checked
def estimate_motion(
    points_a: Float[np.ndarray, "n 2"],
    points_b: Float[np.ndarray, "n 2"],
    K_a: Float[np.ndarray, "3 3"],
    K_b: Float[np.ndarray, "3 3"],
    *,
    threshold_px: float = 1.0,
    seed: int = 0,
) -> EstimatedMotion | None:
    """Motion of matched points, by RANSAC over essential matrices; None if they determine no motion.

    Args:
        points_a: pixels (u, v) in image a.
        points_b: their counterparts in image b.
        K_a: calibration matrix of image a.
        K_b: calibration matrix of image b.
        threshold_px: largest distance from the epipolar line of a match that agrees, in pixels of the mean
            focal length.
        seed: order in which RANSAC meets the matches; the same seed gives the same motion.

    Raises:
        InputError: the threshold is not above 0, or the seed is negative.
    """
    if len(points_a) < _FEWEST:
        return None
    # OpenCV's generator always starts alike, so only the order of the matches is random.
    require_least(seed, 0, "seed of estimate_motion")
    require_above_zero(threshold_px, "threshold_px of estimate_motion")
    order = np.random.default_rng(seed).permutation(len(points_a))
    a, b = (_rays(points, K)[order] for points, K in ((points_a, K_a), (points_b, K_b)))
    focal = float(np.mean([K_a[0, 0], K_a[1, 1], K_b[0, 0], K_b[1, 1]]))
    candidates, agreeing = cv2.findEssentialMat(
        a, b, cameraMatrix=np.eye(3), method=cv2.RANSAC, prob=_CONFIDENCE, threshold=threshold_px / focal
    )
    if candidates is None:
        return None
    best = None
    for essential in candidates.reshape(-1, 3, 3):
        count, R, t, in_front, _ = cv2.recoverPose(
            essential, a, b, np.eye(3), distanceThresh=_FURTHEST, mask=agreeing.copy()
        )
        if best is None or count > best[0]:
            best = count, R, t[:, 0], in_front
    if best is None or not best[0]:
        return None
    inliers = np.zeros(len(order), bool)
    inliers[order] = best[3].ravel() > 0
    return EstimatedMotion(best[1], best[2], inliers)


@checked
def pose_error(estimate: EstimatedMotion | None, T_b_a: Float[np.ndarray, "4 4"]) -> PoseError:
    """Angular errors against the true motion.

    Args:
        estimate: estimated motion; None gives errors of 180 degrees.
        T_b_a: the true motion, whose translation must not be zero.
    """
    if estimate is None:
        return PoseError(180.0, 180.0)
    # The angle follows from the chord, because arccos loses half the digits of a small angle.
    chord = np.linalg.norm(estimate.R_b_a - T_b_a[:3, :3]) / np.sqrt(8)
    true = T_b_a[:3, 3] / np.linalg.norm(T_b_a[:3, 3])
    sine, cosine = np.linalg.norm(np.cross(estimate.direction, true)), abs(estimate.direction @ true)
    return PoseError(
        float(np.degrees(2 * np.arcsin(min(chord, 1.0)))), float(np.degrees(np.arctan2(sine, cosine)))
    )


def _rays(points: Float[np.ndarray, "n 2"], K: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "n 2"]:
    """Points on the plane at distance 1."""
    return (np.asarray(points, np.float64) - K[:2, 2]) / np.diag(K)[:2]
