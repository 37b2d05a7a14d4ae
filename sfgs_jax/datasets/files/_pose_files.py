"""Ground-truth poses from text files; a pose that is not finite does not spoil the others."""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt, file_text
from sfgs_jax.geometry import Trajectory, parse_tum, rotations_from_quaternions

# Files keep few digits, so the singular values of a rotation are off by some 1e-3.
_RIGID_TOLERANCE = 0.02
# Metres. A larger number is damage, and products of it would overflow.
_FARTHEST = 1e9
# Seconds.
_LATEST = 1e12
_LEAST_QUATERNION = 1e-6


def read_text(path: Path) -> str:
    """The text of a file in UTF-8. Raises InputError if it can't be read."""
    try:
        return file_text(path)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {excerpt(error)}.") from error


def read_numbers(path: Path) -> list[list[float]]:
    """The numbers of every line that isn't empty; `#` starts a comment. Raises InputError at other words."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise InputError(
                f"{path}, line {number}: expected numbers, found {excerpt(line.strip())}."
            ) from None
        if row:
            rows.append(row)
    return rows


def read_table(path: Path, *columns: str) -> Float[np.ndarray, "n k"]:
    """Columns of numbers of a CSV file whose first line names them; an empty cell is NaN.

    Args:
        path: the file.
        columns: names of the wanted columns.

    Raises:
        InputError: the file can't be read, lacks a column, or has a line that isn't as its first.
    """
    header, *lines = read_text(path).splitlines() or [""]
    names = [name.strip() for name in header.lstrip("#").split(",")]
    missing = [name for name in columns if name not in names]
    if missing:
        raise InputError(f"{path} lacks the column {missing[0]!r}; its first line should name it.")
    wanted = [names.index(name) for name in columns]
    rows = []
    for number, line in enumerate(lines, start=2):
        if not line.strip():
            continue
        cells = [cell.strip() for cell in line.split(",")]
        try:
            rows.append([float(cells[i] or "nan") for i in wanted])
        except (ValueError, IndexError):
            raise InputError(
                f"{path}, line {number}: expected numbers under {', '.join(columns)}, found {excerpt(line)}."
            ) from None
    return np.asarray(rows, np.float64).reshape(-1, len(columns))


def read_matrix_rows(path: Path) -> Float[np.ndarray, "n 4 4"]:
    """Camera-to-world poses, one a line: the 16 numbers of a 4x4 matrix row by row, or the first 12 of them.

    Poses that aren't finite rigid motions are all NaN.

    Raises:
        InputError: the file can't be read, or a line has another number of numbers.
    """
    rows = read_numbers(path)
    for number, row in enumerate(rows, start=1):
        if len(row) not in (12, 16):
            raise InputError(
                f"{path}: pose {number} has {len(row)} numbers; expected the 16 (or 12) of a 4x4 matrix."
            )
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    for pose, row in zip(poses, rows, strict=True):
        pose[:3] = np.reshape(row[:12], (3, 4))
    return rigid_poses(poses)


def read_matrix_file(path: Path) -> Float[np.ndarray, "4 4"]:
    """The pose in a file with one 4x4 matrix; all NaN if it isn't a finite rigid motion.

    Raises:
        InputError: the file can't be read or doesn't hold 16 numbers.
    """
    numbers = [value for row in read_numbers(path) for value in row]
    if len(numbers) != 16:
        raise InputError(f"{path} has {len(numbers)} numbers; expected the 16 of a 4x4 matrix.")
    return rigid_poses(np.reshape(numbers, (1, 4, 4)))[0]


def read_tum_poses(path: Path) -> tuple[Trajectory, int]:
    """Poses of a file in TUM format, without those that are not finite.

    Returns:
        The finite poses in order of time, and how many were not finite.

    Raises:
        InputError: the file can't be read, or a line isn't `t tx ty tz qx qy qz qw`.
    """
    lines = read_text(path).splitlines()
    broken = 0
    for i, line in enumerate(lines):
        if _is_broken_tum(line):
            lines[i] = "#"  # stays as a line, so that errors name the right one
            broken += 1
    trajectory = parse_tum("\n".join(lines), str(path))
    order = np.argsort(trajectory.timestamps, kind="stable")
    return trajectory[order], broken


def rigid_poses(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """Poses with orthonormal rotations (by SVD); NaN for those that aren't finite rigid motions."""
    poses = np.asarray(poses, np.float64)
    finite = np.asarray((np.abs(poses) < _FARTHEST).all(axis=(1, 2)))
    finite &= (np.abs(poses[:, 3] - [0, 0, 0, 1]) < _RIGID_TOLERANCE).all(axis=1)
    u, s, vt = np.linalg.svd(np.where(finite[:, None, None], poses, np.eye(4))[:, :3, :3])
    rigid = finite & np.all(np.abs(s - 1) < _RIGID_TOLERANCE, axis=1) & (np.linalg.det(u @ vt) > 0)
    result = np.full_like(poses, np.nan)
    result[rigid] = poses[rigid]
    result[rigid, 3] = 0, 0, 0, 1
    result[rigid, :3, :3] = (u @ vt)[rigid]
    return result


def quaternion_poses(
    positions: Float[np.ndarray, "n 3"], xyzw: Float[np.ndarray, "n 4"]
) -> Float[np.ndarray, "n 4 4"]:
    """Poses of positions in metres and quaternions with their real part last; NaN where one is broken."""
    usable = np.all(np.abs(np.concatenate([positions, xyzw], axis=1)) < _FARTHEST, axis=1)
    usable &= np.linalg.norm(np.where(usable[:, None], xyzw, 0), axis=1) > 0.5
    poses = np.tile(np.eye(4), (len(positions), 1, 1))
    poses[:, :3, :3] = rotations_from_quaternions(np.where(usable[:, None], xyzw, 1.0)[:, [3, 0, 1, 2]])
    poses[:, :3, 3] = positions
    poses[~usable] = np.nan
    return poses


def inverse_poses(poses: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """World-to-camera poses from camera-to-world, or the other way; NaN stays NaN."""
    inverse = poses.copy()
    inverse[:, :3, :3] = poses[:, :3, :3].swapaxes(1, 2)
    inverse[:, :3, 3:] = -inverse[:, :3, :3] @ poses[:, :3, 3:]
    return inverse


def opencv_poses(opengl: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 4 4"]:
    """Camera-to-world poses of OpenCV's camera axes from those of OpenGL's (x right, y up, z backward)."""
    return opengl @ np.diag([1.0, -1.0, -1.0, 1.0])


def _is_broken_tum(line: str) -> bool:
    words = line.split("#")[0].replace(",", " ").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return False
    return len(numbers) == 8 and (
        not all(abs(x) < _LATEST for x in numbers[:1])
        or not all(abs(x) < _FARTHEST for x in numbers[1:])
        or math.hypot(*numbers[4:]) < _LEAST_QUATERNION
    )
