"""Ground truth of a recording's frames, with notes on poses that are missing."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._association import poses_at
from sfgs_jax.datasets.files._pose_files import read_matrix_rows, read_numbers, read_tum_poses
from sfgs_jax.geometry import Trajectory


def ground_truth_by_frame(
    poses: Sequence[Float[np.ndarray, "4 4"] | None], timestamps: Float[np.ndarray, " n"]
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from one pose a frame.

    Args:
        poses: `T_world_cam` of each of the N frames: NaN if it can't be used, None if there is none.
        timestamps: of the frames, seconds.

    Returns:
        The usable poses, or None without any; and notes for the log.
    """
    usable = [pose is not None and bool(np.isfinite(pose).all()) for pose in poses]
    missing = sum(pose is None for pose in poses)
    if missing == len(poses):
        return None, []
    notes = not_finite_notes(len(poses) - missing - sum(usable))
    if missing:
        notes.append(f"{missing} of {len(poses)} frames have no ground-truth pose.")
    if not any(usable):
        return None, notes
    known = np.flatnonzero(usable)
    stacked = np.stack([pose for pose, use in zip(poses, usable, strict=True) if use and pose is not None])
    return Trajectory(np.asarray(timestamps, np.float64)[known], stacked), notes


def ground_truth_by_time(
    path: Path, timestamps: Float[np.ndarray, " n"], limit: float
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from a file in TUM format, interpolated at the frames' times.

    Args:
        path: the file; without one there is no ground truth.
        timestamps: of the frames, seconds.
        limit: largest distance in time of a pose to be used, seconds.

    Returns:
        Poses of the frames that have one, or None without any; and notes for the log.

    Raises:
        InputError: the file isn't in TUM format.
    """
    if not path.is_file():
        return None, []
    trajectory, broken = read_tum_poses(path)
    return ground_truth_of_trajectory(trajectory, broken, path, timestamps, limit)


def ground_truth_of_trajectory(
    trajectory: Trajectory, broken: int, path: Path, timestamps: Float[np.ndarray, " n"], limit: float
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from a trajectory, interpolated at the frames' times.

    Args:
        trajectory: poses in order of time.
        broken: number of poses of the file that could not be used.
        path: the file, for messages.
        timestamps: of the frames, seconds.
        limit: as in `ground_truth_by_time`.

    Returns:
        As `ground_truth_by_time`.
    """
    notes = not_finite_notes(broken)
    if not len(trajectory):
        return None, [*notes, f"{path} has no poses."]
    trajectory, known = poses_at(trajectory, timestamps, limit)
    missing = len(timestamps) - len(known)
    if missing:
        notes.append(f"{missing} of {len(timestamps)} frames have no ground-truth pose within {limit:g} s.")
    return (trajectory if len(known) else None), notes


def ground_truth_of_file(
    path: Path, timestamps: Float[np.ndarray, " n"], limit: float
) -> tuple[Trajectory | None, list[str]]:
    """Ground truth from a user's file: by time from TUM lines, or by frame from lines of a 4x4 matrix.

    Args:
        path: the file; without one there is no ground truth.
        timestamps: of the frames, seconds.
        limit: as in `ground_truth_by_time`.

    Returns:
        As `ground_truth_by_time`.

    Raises:
        InputError: the file is in neither form, or has not one matrix a frame.
    """
    if not path.is_file():
        return None, []
    rows = read_numbers(path)
    if not rows:
        return None, [f"{path} has no poses."]
    if len(rows[0]) == 8:
        return ground_truth_by_time(path, timestamps, limit)
    poses = read_matrix_rows(path)
    if len(poses) != len(timestamps):
        raise InputError(
            f"{path} has {len(poses)} poses for {len(timestamps)} frames; give one line per frame "
            "('nan' where a pose is unknown), or TUM lines with time stamps."
        )
    return ground_truth_by_frame(list(poses), timestamps)


def not_finite_notes(count: int) -> list[str]:
    """The note on `count` poses that are not finite; no note for 0."""
    if not count:
        return []
    return [f"{count} ground-truth pose{'s are' if count > 1 else ' is'} not finite and ignored."]
