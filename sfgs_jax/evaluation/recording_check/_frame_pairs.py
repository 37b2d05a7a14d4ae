"""Pairs of frames with matched keypoints, and the motion that depth on the keypoints gives."""

import itertools
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.evaluation.recording_check._sample import RecordingSample, SampledFrame

_KEYPOINTS = 700
_RATIO = 0.8
"""Lowe's ratio of the distances to the nearest and the second nearest descriptor."""
_MOST_PAIRS = 4
"""Pairs of a window that are kept."""
_FEWEST_MATCHES = 20
_LEAST_SHIFT = 0.01
"""Median distance of matches, in widths of the image: a pair without motion says nothing."""


@dataclass(frozen=True)
class FramePair:
    """Two frames, and keypoints of both that a rigid scene explains.

    Attributes:
        first: a key frame.
        second: a later key frame.
        pixels_first: (u, v) of matched keypoints.
        pixels_second: the same in the other image.
        depth: of the first frame.
        shift: median distance between them, pixels.
    """

    first: SampledFrame
    second: SampledFrame
    pixels_first: Float[np.ndarray, "n 2"]
    pixels_second: Float[np.ndarray, "n 2"]
    depth: Float[np.ndarray, "h w"]
    shift: float


@dataclass(frozen=True)
class Motion:
    """Camera motion of a pair, in units of the depth.

    Attributes:
        T_second_first: moves points of the first camera to the second's.
        inliers: of the matches with depth, those that agree with it.
        points: of the first camera, of the matches with depth.
        pixels: of these matches in the second image.
    """

    T_second_first: Float[np.ndarray, "4 4"]
    inliers: Bool[np.ndarray, " m"]
    points: Float[np.ndarray, "m 3"]
    pixels: Float[np.ndarray, "m 2"]

    @property
    def share(self) -> float:
        """Share of the matches with depth that agree with the motion."""
        return float(self.inliers.mean())


PairMotion = tuple[FramePair, Motion]


def frame_pairs(sample: RecordingSample) -> list[FramePair]:
    """The best pairs of key frames of each window: many matches, and enough motion between them.

    Args:
        sample: of a recording.
    """
    pairs = []
    for window in sample.windows:
        keys = [(frame, frame.depth) for frame in window if frame.depth is not None]
        found = [_keypoints(frame) for frame, _ in keys]
        candidates = []
        for a, b in itertools.combinations(range(len(keys)), 2):
            pair = _pair(keys[a], keys[b][0], found[a], found[b], sample)
            if pair is not None and pair.shift >= _LEAST_SHIFT * sample.shape[1]:
                candidates.append(pair)
        # The square root of the shift weighs a long baseline against matches that get fewer with it.
        candidates.sort(key=lambda pair: -len(pair.pixels_first) * np.sqrt(pair.shift))
        pairs += candidates[:_MOST_PAIRS]
    return pairs


def motion_of(pair: FramePair, depth: Float[np.ndarray, "h w"], sample: RecordingSample) -> Motion | None:
    """Motion of the camera from matches with depth, by perspective n points in RANSAC.

    Args:
        pair: matched keypoints.
        depth: of the first frame, in any unit.
        sample: where the pair is from.

    Returns:
        None if too few matches have depth or none of the motions fits.
    """
    points, known = lifted(pair.pixels_first, depth, sample.matrix)
    points, pixels = points[known], pair.pixels_second[known]
    if len(points) < _FEWEST_MATCHES // 2:
        return None
    try:
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            points,
            pixels,
            sample.matrix,
            None,
            iterationsCount=200,
            reprojectionError=max(1.0, 2 * sample.pixel),
            flags=cv2.SOLVEPNP_SQPNP,
        )
    except cv2.error:
        return None
    if not ok or inliers is None or len(inliers) < 6:
        return None
    rows = np.asarray(inliers, np.int64).ravel()
    rotation, translation = cv2.solvePnPRefineLM(
        points[rows], pixels[rows], sample.matrix, None, rotation, translation
    )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], translation.ravel()
    mask = np.zeros(len(points), bool)
    mask[rows] = True
    return Motion(T, mask, points, pixels)


def lifted(
    pixels: Float[np.ndarray, "n 2"], depth: Float[np.ndarray, "h w"], matrix: Float[np.ndarray, "3 3"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Points of the camera at pixels, and which of them have depth.

    Args:
        pixels: (u, v).
        depth: in any unit; 0 where missing.
        matrix: K.
    """
    columns, rows = np.clip(np.rint(pixels).astype(int), 0, np.array(depth.shape[::-1]) - 1).T
    z = depth[rows, columns].astype(np.float64)
    rays = np.c_[(pixels - matrix[:2, 2]) / matrix[[0, 1], [0, 1]], np.ones(len(pixels))]
    return rays * z[:, None], z > 0


def _keypoints(frame: SampledFrame) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 128"]]:
    mask = None if frame.seen is None else frame.seen.astype(np.uint8)
    found, descriptors = cv2.SIFT.create(nfeatures=_KEYPOINTS).detectAndCompute(frame.grey, mask)
    if not found:
        return np.zeros((0, 2)), np.zeros((0, 128), np.float32)
    return np.asarray(cv2.KeyPoint.convert(found), np.float64), descriptors


def _pair(
    first: tuple[SampledFrame, Float[np.ndarray, "h w"]],
    second: SampledFrame,
    found_first: tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 128"]],
    found_second: tuple[Float[np.ndarray, "m 2"], Float[np.ndarray, "m 128"]],
    sample: RecordingSample,
) -> FramePair | None:
    if min(len(found_first[0]), len(found_second[0])) < _FEWEST_MATCHES:
        return None
    rows = _matches(found_first[1], found_second[1])
    if len(rows) < _FEWEST_MATCHES:
        return None
    a, b = found_first[0][rows[:, 0]], found_second[0][rows[:, 1]]
    try:
        _, mask = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, max(1.0, 1.5 * sample.pixel), 0.999, 500)
    except cv2.error:
        return None
    if mask is None or np.count_nonzero(mask) < _FEWEST_MATCHES:
        return None
    kept = mask.ravel() > 0
    a, b = a[kept], b[kept]
    return FramePair(first[0], second, a, b, first[1], float(np.median(np.linalg.norm(a - b, axis=1))))


def _matches(a: Float[np.ndarray, "n 128"], b: Float[np.ndarray, "m 128"]) -> np.ndarray:
    """Rows of mutual nearest neighbours that pass Lowe's ratio test."""
    similar = a @ b.T
    # SIFT descriptors have one length, so the nearest is the most similar.
    squares = np.maximum((a * a).sum(1)[:, None] + (b * b).sum(1) - 2 * similar, 0)
    nearest = squares.argmin(axis=1)
    best = np.sqrt(squares[np.arange(len(a)), nearest])
    squares_without = squares.copy()
    squares_without[np.arange(len(a)), nearest] = np.inf
    second = np.sqrt(squares_without.min(axis=1))
    mutual = squares.argmin(axis=0)[nearest] == np.arange(len(a))
    rows = np.flatnonzero(mutual & (best < _RATIO * second))
    return np.c_[rows, nearest[rows]]
