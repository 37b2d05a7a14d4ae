"""Pairs of frames of a recording whose poses are known."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.datasets._recording import Recording


@dataclass(frozen=True)
class RecordingPair:
    """Two frames of a recording.

    Attributes:
        index_a: frame a.
        index_b: frame b.
        T_b_a: takes camera coordinates of a to those of b, metres.
    """

    index_a: int
    index_b: int
    T_b_a: Float[np.ndarray, "4 4"]

    @property
    def gap(self) -> int:
        """Number of frames between them."""
        return self.index_b - self.index_a


@checked
def recording_pairs(
    recording: Recording,
    *,
    gaps: Sequence[int] = (10, 20, 30, 45),
    stride: int = 7,
    min_distance: float = 0.1,
    max_distance: float = np.inf,
    max_angle_deg: float = 45.0,
) -> list[RecordingPair]:
    """Pairs of frames at given gaps, by gap and then by frame.

    A pair is left out if it lacks a pose or hardly moves: the direction of its translation would be noise.
    So is a pair that turns so far that its frames see different things.

    Args:
        recording: with ground truth.
        gaps: numbers of frames from the first to the second of a pair.
        stride: step from one pair's first frame to the next one's.
        min_distance: least distance between the cameras, metres.
        max_distance: largest distance between the cameras, metres.
        max_angle_deg: largest angle between the cameras' orientations, degrees.

    Raises:
        InputError: there is no ground truth, a gap or the stride is not positive, or no pair is left.
    """
    truth = recording.ground_truth
    if truth is None:
        raise InputError(f"{recording.name} has no ground-truth poses to take pairs by.")
    if stride < 1 or min(gaps, default=0) < 1:
        raise InputError(f"Gaps and stride must be at least 1, not {tuple(gaps)} and {stride}.")
    pose_at = dict(zip(truth.timestamps.tolist(), truth.poses, strict=True))
    T_world_cam = [pose_at.get(time) for time in recording.timestamps.tolist()]
    min_cosine = np.cos(np.radians(max_angle_deg))
    pairs = []
    for gap in gaps:
        for a in range(0, len(recording) - gap, stride):
            T_world_a, T_world_b = T_world_cam[a], T_world_cam[a + gap]
            if T_world_a is None or T_world_b is None:
                continue
            T_b_a = np.linalg.inv(T_world_b) @ T_world_a
            distance = np.linalg.norm(T_b_a[:3, 3])
            cosine = (np.trace(T_b_a[:3, :3]) - 1) / 2
            if min_distance <= distance <= max_distance and cosine >= min_cosine:
                pairs.append(RecordingPair(a, a + gap, T_b_a))
    if not pairs:
        raise InputError(
            f"No frames of {recording.name} that are {', '.join(map(str, gaps))} apart lie within the limits "
            f"of {min_distance:g} to {max_distance:g} m and {max_angle_deg:g} degrees."
        )
    return pairs
