"""Time-stamped camera poses on the host, and the text formats of TUM and KITTI."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, described, excerpt, file_text
from sfgs_jax.geometry import se3
from sfgs_jax.geometry._rotations import quaternions_from_rotations, rotations_from_quaternions

# Seconds and metres; a larger number is damage.
_LARGEST = 1e12
_LEAST_QUATERNION = 1e-6


@dataclass(frozen=True)
class Trajectory:
    """Camera poses with their times, float64 on the host.

    Attributes:
        timestamps: (N,) seconds, float64.
        poses: (N, 4, 4) `T_world_cam`, float64.

    Raises:
        InputError: they are something else.
    """

    timestamps: np.ndarray
    poses: np.ndarray

    def __post_init__(self) -> None:
        times, poses = self.timestamps, self.poses
        arrays = isinstance(times, np.ndarray) and isinstance(poses, np.ndarray)
        if not arrays or times.ndim != 1 or poses.shape != (len(times), 4, 4):
            raise InputError(
                "The timestamps and poses of a Trajectory are NumPy arrays (N,), seconds, and (N, 4, 4), not "
                f"{described(times)} and {described(poses)}."
            )

    def __len__(self) -> int:
        return len(self.timestamps)

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) camera centres in world coordinates, metres."""
        return self.poses[:, :3, 3]

    def __getitem__(self, index: slice | np.ndarray) -> "Trajectory":
        return Trajectory(self.timestamps[index], self.poses[index])


@checked
def parse_tum(text: str, name: str) -> Trajectory:
    """Read TUM lines `t tx ty tz qx qy qz qw`; `#` starts a comment.

    Args:
        text: the file's text.
        name: what to call it in an error.

    Raises:
        InputError: a line without eight finite numbers, or a zero quaternion.
    """
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.split("#")[0].replace(",", " ").strip()
        if not line:
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != 8:
            raise InputError(
                f"{name}, line {number}: expected 't tx ty tz qx qy qz qw', found {excerpt(line)}."
            )
        if not all(abs(x) < _LARGEST for x in row) or not math.hypot(*row[4:]) > _LEAST_QUATERNION:
            raise InputError(
                f"{name}, line {number}: the pose is not finite or has no rotation: {excerpt(line)}."
            )
        rows.append(row)
    table = np.asarray(rows, np.float64).reshape(-1, 8)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    if len(table):
        poses[:, :3, :3] = rotations_from_quaternions(table[:, [7, 4, 5, 6]])
    poses[:, :3, 3] = table[:, 1:4]
    return Trajectory(table[:, 0], poses)


@checked
def read_tum(path: Path | str) -> Trajectory:
    """Read a trajectory in TUM format. Raises InputError as `parse_tum` does, or if there is no such file."""
    try:
        text = file_text(path)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read the trajectory {path}: {excerpt(error)}.") from error
    return parse_tum(text, str(path))


@checked
def format_tum(trajectory: Trajectory) -> str:
    """The trajectory as TUM text: time stamps to the microsecond, poses to nine digits."""
    xyzw = quaternions_from_rotations(trajectory.poses[:, :3, :3])[:, [1, 2, 3, 0]]
    lines = [
        f"{t:.6f} " + " ".join(f"{value:.9f}" for value in (*position, *quaternion))
        for t, position, quaternion in zip(trajectory.timestamps, trajectory.positions, xyzw, strict=True)
    ]
    return "".join(line + "\n" for line in ["# timestamp tx ty tz qx qy qz qw", *lines])


@checked
def format_kitti(trajectory: Trajectory) -> str:
    """The trajectory as KITTI text: a line of the 3 x 4 matrix by rows for each pose, without time stamps."""
    rows = trajectory.poses[:, :3].reshape(-1, 12)
    return "".join(" ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)


@checked
def twists_of(trajectory: Trajectory) -> Float[np.ndarray, "n 6"]:
    """Motion per second in each camera's own frame, from the pose before it to the pose after it.

    Args:
        trajectory: poses in order of time. A single one has no motion, nor have poses of one time.
    """
    count = len(trajectory)
    if count < 2:
        return np.zeros((count, 6))
    before, after = np.maximum(np.arange(count) - 1, 0), np.minimum(np.arange(count) + 1, count - 1)
    moved = np.linalg.inv(trajectory.poses[before]) @ trajectory.poses[after]
    seconds = trajectory.timestamps[after] - trajectory.timestamps[before]
    # Frames of one time, by stamps to the microsecond, tell no motion.
    return se3.logs_of(moved) * np.divide(1, seconds, out=np.zeros(count), where=seconds > 0)[:, None]
