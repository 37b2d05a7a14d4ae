"""Ways of a camera to draw from: a steadied trajectory, and a circle around a point."""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter1d

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry._rotations import quaternions_from_rotations, rotations_from_quaternions
from sfgs_jax.geometry._trajectory import Trajectory

_WIDEST = 100_000
"""Poses of the widest filter."""


@checked
def smoothed(trajectory: Trajectory, sigma: float) -> Trajectory:
    """A trajectory without the shake of the hand: positions and quaternions under a Gaussian filter.

    Args:
        trajectory: poses in order of time, about evenly spaced.
        sigma: standard deviation of the filter, in poses; 0 leaves the trajectory as it is.

    Raises:
        InputError: `sigma` is negative, or far beyond any trajectory.
    """
    if not 0 <= sigma <= _WIDEST:
        raise InputError(
            f"The standard deviation of a filter must be a number from 0, not {sigma!r}, "
            f"and at most {_WIDEST}."
        )
    if sigma == 0 or len(trajectory) < 2:
        return trajectory
    quaternions = quaternions_from_rotations(trajectory.poses[:, :3, :3])
    # A quaternion and its negative are one rotation: each takes the sign that is nearer to the one before.
    turned = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    quaternions[1:] *= np.where(np.cumsum(turned) % 2, -1, 1)[:, None]
    poses = trajectory.poses.copy()
    poses[:, :3, :3] = rotations_from_quaternions(gaussian_filter1d(quaternions, sigma, 0, mode="nearest"))
    poses[:, :3, 3] = gaussian_filter1d(trajectory.positions, sigma, 0, mode="nearest")
    return Trajectory(trajectory.timestamps, poses)


@checked
def orbit(
    target: Float[np.ndarray, "3"],
    up: Float[np.ndarray, "3"],
    *,
    radius: float,
    elevation: float = 0.0,
    num_poses: int = 120,
) -> Float[np.ndarray, "n 4 4"]:
    """Poses `T_world_cam` on a circle around a point, each looking at it: a turntable.

    The next pose after the last would be the first.

    Args:
        target: the point, metres.
        up: direction that is upwards in the images, of any length.
        radius: distance of the cameras from the point, metres.
        elevation: angle by which the cameras are above the point, radians, within a quarter turn.
        num_poses: number of poses.

    Raises:
        InputError: `up` is zero, the radius or the number is not positive, or the elevation is too steep.
    """
    length = float(np.linalg.norm(up))
    if not (0 < length < np.inf and 0 < radius < np.inf and num_poses >= 1):
        raise InputError(
            "An orbit needs a direction upwards, a radius above 0 and at least one pose, "
            f"not {up}, {radius!r} and {num_poses!r}."
        )
    if not abs(elevation) < np.pi / 2:
        raise InputError(
            f"The elevation of an orbit lies within a quarter turn (1.57 rad), not at {elevation!r}."
        )
    up = np.asarray(up, np.float64) / length
    # The first camera looks as nearly along z as it can, which is how a run's first camera looks.
    away = np.eye(3)[2 if abs(up[2]) < 0.9 else 0]
    ahead = away - (away @ up) * up
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, up)
    angle = 2 * np.pi * np.arange(num_poses)[:, None] / num_poses
    level = np.cos(angle) * ahead - np.sin(angle) * right
    forward = np.cos(elevation) * level - np.sin(elevation) * up
    down = -np.cos(elevation) * up - np.sin(elevation) * level
    poses = np.tile(np.eye(4), (num_poses, 1, 1))
    poses[:, :3, :3] = np.stack([np.cross(down, forward), down, forward], axis=2)
    poses[:, :3, 3] = target - radius * forward
    return poses
