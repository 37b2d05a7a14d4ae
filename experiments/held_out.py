"""Figures of poses that need no ground truth: do surfaces and matches agree by them?"""

import numpy as np
from jaxtyping import Float

from experiments.pose_agreement import (
    EVERY,
    GAP,
    MIN_POINTS,
    Surfaces,
    agreed_matches,
    distances,
    misses,
    pairs,
)
from experiments.starts import true_poses
from sfgs_jax.datasets import Recording


class HeldOut:
    """Figures of poses by what the images of a recording show, as `experiments.pose_agreement` takes them.

    One serves all variants on a start: matches and surfaces do not depend on poses and are kept. Pairs of
    surfaces are chosen by the ground truth if there is one, so all variants are judged by the same pairs. A
    pair without both poses is left out. Surfaces farther apart than `GATE` do not count, so a gross error
    shows in the matches only.

    Args:
        recording: the start.
        stride: frames of the whole recording from one of its frames to the next.
    """

    def __init__(self, recording: Recording, stride: int) -> None:
        self._recording, self._stride = recording, stride
        self._surfaces = Surfaces(recording)
        self._matches: dict[int, tuple[np.ndarray, np.ndarray] | None] = {}

    def surface_m(self, poses: Float[np.ndarray, "n 4 4"]) -> float:
        """Median distance between the surfaces of frames far apart in time, metres.

        Args:
            poses: (N, 4, 4) `T_world_cam` of the frames, NaN where there is none.
        """
        known = self._recording.ground_truth is not None
        measured = []
        for i, j in pairs(true_poses(self._recording) if known else poses, self._stride):
            T_j_i = np.linalg.inv(poses[j]) @ poses[i]
            if np.isfinite(T_j_i).all():
                found = distances(self._surfaces[i], self._surfaces[j], T_j_i, self._recording.camera)
                measured += [found] if len(found) >= MIN_POINTS else []
        return float(np.median(np.concatenate(measured))) if measured else np.nan

    def reprojection_px(self, poses: Float[np.ndarray, "n 4 4"]) -> float:
        """Median miss of matches of ORB's keypoints, pixels.

        Args:
            poses: (N, 4, 4) `T_world_cam` of the frames, NaN where there is none.
        """
        gap, every = max(1, GAP // self._stride), max(1, EVERY // self._stride)
        measured = []
        for i in range(0, len(poses) - gap, every):
            T_j_i = np.linalg.inv(poses[i + gap]) @ poses[i]
            if not np.isfinite(T_j_i).all():
                continue
            if i not in self._matches:
                self._matches[i] = agreed_matches(self._recording, i, i + gap)
            matches = self._matches[i]
            if matches is not None:
                measured.append(misses(*matches, T_j_i, self._recording.camera))
        return float(np.median(np.concatenate(measured))) if measured else np.nan
