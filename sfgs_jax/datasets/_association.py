"""Association of time stamps of two sensors, and poses at given times."""

import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Trajectory, slerp


@checked
def associate(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " m"], limit: float) -> Int[np.ndarray, "k 2"]:
    """Pairs of nearest time stamps, one to one, by greedy association.

    The closest pairs come first, as in the TUM benchmark's tools, and only neighbours in time are tried. A
    stamp whose neighbours are taken by closer pairs stays without a partner.

    Args:
        a: seconds, sorted.
        b: seconds, sorted.
        limit: largest difference, seconds.

    Returns:
        Indices into a and b, in order of a.
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


@checked
def poses_at(
    trajectory: Trajectory, timestamps: Float[np.ndarray, " n"], limit: float
) -> tuple[Trajectory, Int[np.ndarray, " k"]]:
    """Poses of a trajectory at given times: positions by linear interpolation, rotations by slerp.

    If only one of the two poses around a time is within the limit, it is taken as it is. If neither is, the
    time has no pose.

    Args:
        trajectory: poses in order of time, at least one.
        timestamps: seconds.
        limit: largest distance in time of a pose to be used, seconds.

    Returns:
        The trajectory at the time stamps that have a pose, and the indices of these time stamps.
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
        poses[:, :3, :3] = slerp(rotations[left], rotations[right], fraction)
    return Trajectory(np.asarray(timestamps, np.float64)[known], poses), known
