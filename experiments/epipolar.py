"""Errors of poses that no depth enters: how far matches lie from their epipolar lines.

Keypoints of ORB, which the system does not use, are matched between frames. RANSAC keeps the matches that
some essential matrix explains. Poses are judged by the distances of these from the epipolar lines that the
poses give. Neither depth nor a recording's own poses play a part. A camera that has hardly moved has no
epipolar lines, so pairs need a baseline.
"""

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.datasets import Recording
from sfgs_jax.superfeats import extract_orb, match

GAPS = (30, 60)
"""Frames from one image of a pair to the other."""
EVERY = 10
"""Frames from the first image of a pair to that of the next."""
MIN_BASELINE = 0.05
"""Least distance of a pair's cameras, metres."""
KEYPOINTS, MATCHED_PIXELS, MIN_MATCHES = 2000, 1.0, 40

Pair = tuple[int, int, Float[np.ndarray, "m 3"], Float[np.ndarray, "m 3"]]
"""Numbers of two frames, and the rays of their matches."""


def matched_pairs(recording: Recording, poses: dict[int, Float[np.ndarray, "4 4"]]) -> list[Pair]:
    """Pairs of frames with a baseline, and the matches that an essential matrix explains.

    Args:
        recording: where they are from.
        poses: `T_world_cam` of frames by number; they only tell which pairs have a baseline.
    """
    K = np.asarray(recording.camera.matrix(), np.float64)
    found, pairs = {}, []
    for gap in GAPS:
        for a in range(0, len(recording) - gap, EVERY):
            b = a + gap
            if a not in poses or b not in poses or _baseline(poses[a], poses[b]) < MIN_BASELINE:
                continue
            for number in (a, b):
                if number not in found:
                    found[number] = extract_orb(np.asarray(recording[number].rgb), max_keypoints=KEYPOINTS)
            matches = match(found[a], found[b])
            valid = np.asarray(matches.valid)
            pixels = (
                np.asarray(found[a].keypoints, np.float64)[valid],
                np.asarray(found[b].keypoints, np.float64)[np.asarray(matches.index_b)[valid]],
            )
            if valid.sum() < MIN_MATCHES:
                continue
            _, kept = cv2.findEssentialMat(*pixels, K, cv2.RANSAC, 0.9999, MATCHED_PIXELS)
            good = np.ravel(kept) > 0 if kept is not None else np.zeros(len(pixels[0]), bool)
            if good.sum() >= MIN_MATCHES:
                rays = [np.column_stack([p[good], np.ones(good.sum())]) @ np.linalg.inv(K).T for p in pixels]
                pairs.append((a, b, rays[0], rays[1]))
    return pairs


def epipolar_error(
    pairs: list[Pair], poses: dict[int, Float[np.ndarray, "4 4"]], focal_length: float
) -> float:
    """Median over the pairs of the median distance of matches from their epipolar lines, pixels.

    Sampson's distance; Hartley and Zisserman, Multiple View Geometry, section 11.4.3.

    Args:
        pairs: from `matched_pairs`.
        poses: `T_world_cam` of frames by number; pairs without both are left out.
        focal_length: pixels.
    """
    errors = []
    for a, b, from_, to in pairs:
        if a not in poses or b not in poses:
            continue
        T_b_a = np.linalg.inv(poses[b]) @ poses[a]
        essential = np.cross(np.eye(3), T_b_a[:3, 3]).T @ T_b_a[:3, :3]
        lines_b, lines_a = from_ @ essential.T, to @ essential
        length = np.sqrt((lines_b[:, :2] ** 2).sum(1) + (lines_a[:, :2] ** 2).sum(1))
        errors.append(np.median(np.abs((to * lines_b).sum(1)) / length))
    return focal_length * float(np.median(errors)) if errors else float("nan")


def _baseline(a: Float[np.ndarray, "4 4"], b: Float[np.ndarray, "4 4"]) -> float:
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3]))
