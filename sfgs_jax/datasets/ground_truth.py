"""Ground truth of a recording's frames, and what to say about poses that are missing."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sfgs_jax.datasets.association import poses_at
from sfgs_jax.datasets.pose_files import read_tum_poses
from sfgs_jax.geometry import Trajectory


def ground_truth_of(
    poses: Sequence[np.ndarray | None], timestamps: np.ndarray
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from one pose a frame, and notes for the log.

    Args:
        poses: N times (4, 4) `T_world_cam`, NaN where it can't be used, None without one.
        timestamps: (N,) of the frames, seconds.
    """
    usable = [pose is not None and bool(np.isfinite(pose).all()) for pose in poses]
    missing = sum(pose is None for pose in poses)
    if missing == len(poses):
        return None, []
    notes = not_finite_note(len(poses) - missing - sum(usable))
    if missing:
        notes.append(f"{missing} of {len(poses)} frames have no ground-truth pose.")
    if not any(usable):
        return None, notes
    known = np.flatnonzero(usable)
    stacked = np.stack([pose for pose, use in zip(poses, usable, strict=True) if use and pose is not None])
    return Trajectory(np.asarray(timestamps, np.float64)[known], stacked), notes


def ground_truth_by_time(
    path: Path, timestamps: np.ndarray, limit: float
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from a file in TUM format, and notes for the log.

    Args:
        path: the file; without one there is no ground truth.
        timestamps: (N,) of the frames, seconds.
        limit: largest distance in time of a pose to be used, seconds.

    Raises:
        InputError: the file isn't in TUM format.
    """
    if not path.is_file():
        return None, []
    trajectory, broken = read_tum_poses(path)
    notes = not_finite_note(broken)
    if not len(trajectory):
        return None, [*notes, f"{path} has no poses."]
    trajectory, known = poses_at(trajectory, timestamps, limit)
    missing = len(timestamps) - len(known)
    if missing:
        notes.append(f"{missing} of {len(timestamps)} frames have no ground-truth pose within {limit:g} s.")
    return (trajectory if len(known) else None), notes


def not_finite_note(count: int) -> list[str]:
    """The note on `count` poses that are not finite; none for 0."""
    if not count:
        return []
    return [f"{count} ground-truth pose{'s are' if count > 1 else ' is'} not finite and ignored."]
