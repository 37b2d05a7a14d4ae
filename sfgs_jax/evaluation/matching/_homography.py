"""Keypoints and matches between images with a known homography: repeatability, matching score, corner error.

The homography `H_b_a` takes pixels (u, v) of image a to pixels of image b. Pixel centres lie at integers, and
its last element is positive. Shapes are (height, width).

Source: DeTone et al., SuperPoint (CVPR workshops 2018), appendices A to C.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.arrays import checked, require_above_zero, require_least

_CONFIDENCE = 0.9999
_MAX_ITERATIONS = 5000
# A homography has eight unknowns.
_FEWEST = 4


@checked
def transfer(H_b_a: Float[np.ndarray, "3 3"], points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Places in image b of pixels of image a; infinite for pixels at the horizon or beyond.

    Args:
        H_b_a: the homography.
        points: pixels in image a.
    """
    mapped = np.asarray(points, np.float64) @ H_b_a[:, :2].T + H_b_a[:, 2]
    in_front = mapped[:, 2:] > 0
    return np.where(in_front, mapped[:, :2] / np.where(in_front, mapped[:, 2:], 1), np.inf)


@checked
def repeatability(
    keypoints_a: Float[np.ndarray, "n 2"],
    keypoints_b: Float[np.ndarray, "m 2"],
    H_b_a: Float[np.ndarray, "3 3"],
    shape_a: tuple[int, int],
    shape_b: tuple[int, int],
    *,
    threshold_px: float = 3.0,
) -> float:
    """Repeatability: share of keypoints with a keypoint of the other image at their place.

    Only keypoints that both images could see count, each once. Without any the share is 0.

    Args:
        keypoints_a: pixels in image a.
        keypoints_b: pixels in image b.
        H_b_a: the homography.
        shape_a: shape of image a.
        shape_b: shape of image b.
        threshold_px: largest distance in image b, pixels.
    """
    places = transfer(H_b_a, keypoints_a)
    places = places[_inside(places, shape_b)]
    others = keypoints_b[_inside(transfer(np.linalg.inv(H_b_a), keypoints_b), shape_a)]
    if not len(places) or not len(others):
        return 0.0
    close = np.linalg.norm(places[:, None] - others, axis=2) <= threshold_px
    return float((close.any(axis=1).sum() + close.any(axis=0).sum()) / (len(places) + len(others)))


@checked
def correct_matches(
    points_a: Float[np.ndarray, "n 2"],
    points_b: Float[np.ndarray, "n 2"],
    H_b_a: Float[np.ndarray, "3 3"],
    *,
    threshold_px: float = 3.0,
) -> Bool[np.ndarray, " n"]:
    """Mask of the matches that the homography confirms.

    Args:
        points_a: pixels in image a.
        points_b: their counterparts in image b.
        H_b_a: the homography.
        threshold_px: largest distance in image b, pixels.
    """
    return np.linalg.norm(transfer(H_b_a, points_a) - points_b, axis=1) <= threshold_px


@checked
def matching_score(
    points_a: Float[np.ndarray, "n 2"],
    points_b: Float[np.ndarray, "n 2"],
    keypoints_a: Float[np.ndarray, "k 2"],
    keypoints_b: Float[np.ndarray, "m 2"],
    H_b_a: Float[np.ndarray, "3 3"],
    shape_a: tuple[int, int],
    shape_b: tuple[int, int],
    *,
    threshold_px: float = 3.0,
) -> float:
    """Matching score: correct matches over the keypoints that both images could see, mean of both images.

    Args:
        points_a: matched keypoints of image a.
        points_b: their counterparts.
        keypoints_a: all keypoints of image a.
        keypoints_b: all keypoints of image b.
        H_b_a: the homography.
        shape_a: shape of image a.
        shape_b: shape of image b.
        threshold_px: as in `correct_matches`.
    """
    correct = correct_matches(points_a, points_b, H_b_a, threshold_px=threshold_px).sum()
    visible = (
        _inside(transfer(H_b_a, keypoints_a), shape_b).sum(),
        _inside(transfer(np.linalg.inv(H_b_a), keypoints_b), shape_a).sum(),
    )
    return float(np.mean([correct / n if n else 0.0 for n in visible]))


@checked
def estimate_homography(
    points_a: Float[np.ndarray, "n 2"],
    points_b: Float[np.ndarray, "n 2"],
    *,
    threshold_px: float = 3.0,
    seed: int = 0,
) -> Float[np.ndarray, "3 3"] | None:
    """`H_b_a` of matched points, by RANSAC; None if they determine no homography.

    Args:
        points_a: pixels in image a.
        points_b: their counterparts in image b.
        threshold_px: largest distance in image b of a match that agrees, pixels.
        seed: order in which RANSAC meets the matches; the same seed gives the same homography.

    Raises:
        InputError: the threshold is not above 0, or the seed is negative.
    """
    if len(points_a) < _FEWEST:
        return None
    # OpenCV's generator always starts alike, so only the order of the matches is random.
    require_least(seed, 0, "seed of estimate_homography")
    require_above_zero(threshold_px, "threshold_px of estimate_homography")
    order = np.random.default_rng(seed).permutation(len(points_a))
    a, b = (np.asarray(points, np.float64)[order] for points in (points_a, points_b))
    found, _ = cv2.findHomography(
        a, b, cv2.RANSAC, threshold_px, maxIters=_MAX_ITERATIONS, confidence=_CONFIDENCE
    )
    return None if found is None or not np.isfinite(found).all() else np.asarray(found, np.float64)


@checked
def corner_error(
    estimate: Float[np.ndarray, "3 3"] | None, H_b_a: Float[np.ndarray, "3 3"], shape_a: tuple[int, int]
) -> float:
    """Mean distance of image a's corners under both homographies, pixels in image b.

    Args:
        estimate: estimated homography; None gives an infinite error.
        H_b_a: the true homography.
        shape_a: shape of image a.
    """
    if estimate is None:
        return float("inf")
    height, width = shape_a
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], np.float64)
    places = transfer(estimate, corners)
    if not np.isfinite(places).all():
        return float("inf")
    return float(np.mean(np.linalg.norm(places - transfer(H_b_a, corners), axis=1)))


def _inside(points: Float[np.ndarray, "n 2"], shape: tuple[int, int]) -> Bool[np.ndarray, " n"]:
    return np.all((points >= -0.5) & (points < np.asarray(shape[::-1]) - 0.5), axis=1)
