"""Match time stamps of two sensors."""

import numpy as np

from sfgs_jax.geometry import Trajectory, quaternions_from_rotations, rotations_from_quaternions


def associate(a: np.ndarray, b: np.ndarray, limit: float) -> np.ndarray:
    """Pairs of nearest time stamps, one to one.

    Pairs are taken greedily, closest first, as the TUM benchmark's tools do, and only among each stamp's
    neighbours in time: a stamp whose neighbours are taken by closer pairs stays without one.

    Args:
        a: (N,) seconds, sorted.
        b: (M,) seconds, sorted.
        limit: largest difference, seconds.

    Returns:
        (K, 2) indices into a and b, in order of a.
    """
    if not len(a) or not len(b):
        return np.zeros((0, 2), np.int64)
    after = np.searchsorted(b, a)
    # Two neighbours on each side: enough unless one sensor is several times as fast as the other.
    candidates = np.clip(after[:, None] + np.arange(-2, 2), 0, len(b) - 1)
    difference = np.abs(b[candidates] - a[:, None])
    rows, columns = np.nonzero(difference <= limit)
    order = np.argsort(difference[rows, columns], kind="stable")
    pairs: dict[int, int] = {}
    taken: set[int] = set()
    for i, j in zip(rows[order].tolist(), candidates[rows, columns][order].tolist(), strict=True):
        if i not in pairs and j not in taken:
            pairs[i] = j
            taken.add(j)
    return np.asarray(sorted(pairs.items()), np.int64).reshape(-1, 2)


def poses_at(trajectory: Trajectory, timestamps: np.ndarray, limit: float) -> tuple[Trajectory, np.ndarray]:
    """Poses of a trajectory at given times, interpolated between the two around each.

    Where only one of the two is within the limit, it is taken as it is; where none is, there is no pose.

    Args:
        trajectory: poses by time, at least one.
        timestamps: (N,) seconds.
        limit: largest distance in time of a pose to be used, seconds.

    Returns:
        the trajectory at the time stamps that have a pose, and their indices (K,).
    """
    times = trajectory.timestamps
    right = np.clip(np.searchsorted(times, timestamps), 0, len(times) - 1)
    left = np.clip(right - 1, 0, None)
    left_near = np.abs(timestamps - times[left]) <= limit
    right_near = np.abs(times[right] - timestamps) <= limit
    gap = times[right] - times[left]
    fraction = np.clip((timestamps - times[left]) / np.where(gap > 0, gap, 1), 0, 1)
    fraction = np.where(left_near & right_near, fraction, np.where(right_near, 1.0, 0.0))
    known = np.flatnonzero(left_near | right_near)
    left, right, fraction = left[known], right[known], fraction[known, None]
    poses = np.tile(np.eye(4), (len(known), 1, 1))
    if len(known):
        poses[:, :3, 3] = (1 - fraction) * trajectory.positions[left] + fraction * trajectory.positions[right]
        rotations = trajectory.poses[:, :3, :3]
        poses[:, :3, :3] = _slerp(rotations[left], rotations[right], fraction)
    return Trajectory(np.asarray(timestamps, np.float64)[known], poses), known


def _slerp(a: np.ndarray, b: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Rotations (N, 3, 3) on the shortest arcs from a to b, at fractions (N, 1)."""
    qa, qb = quaternions_from_rotations(a), quaternions_from_rotations(b)
    cosine = np.sum(qa * qb, axis=1, keepdims=True)
    qb = np.where(cosine < 0, -qb, qb)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    small = angle < 1e-6
    sine = np.where(small, 1, np.sin(angle))
    weight_a = np.where(small, 1 - fraction, np.sin((1 - fraction) * angle) / sine)
    weight_b = np.where(small, fraction, np.sin(fraction * angle) / sine)
    return rotations_from_quaternions(weight_a * qa + weight_b * qb)
