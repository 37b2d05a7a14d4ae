"""Paths of a hand-held camera."""

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from sfgs_jax.geometry import Trajectory, quaternions_from_rotations, se3

_RADIUS = 0.5
_HEIGHT = 1.35
_TURN_PER_FRAME = np.deg2rad(2.7)
"""Mean turn between frames, radians, whatever the number of frames."""
_SWINGS = 3
"""Number of times the camera goes up and down on the way round."""


def closed_path(num_frames: int) -> Float[np.ndarray, "n 4 4"]:
    """Smooth `T_world_cam` whose last pose equals the first.

    The camera walks a circle around the room's middle and looks across it, nodding and swaying a little.
    With at least 115 frames it goes round once or more. With fewer it swings aside and comes back. So the
    pace stays the pace of a hand-held camera: 2 to 3 cm and 2 to 3 degrees a frame.

    Args:
        num_frames: at least 1.
    """
    phase = np.linspace(0, 2 * np.pi, num_frames) if num_frames > 1 else np.zeros(1)
    turn = _TURN_PER_FRAME * (num_frames - 1)
    rounds = int(turn / (2 * np.pi) + 0.15)
    # A swing is fastest half way, where it should not be faster than a hand, so it goes less far.
    angle = rounds * phase if rounds else turn / 4.8 * (1 - np.cos(phase))
    strength = min(1.0, turn / (2 * np.pi))
    swing = _SWINGS * max(rounds, 1) * phase
    radius = _RADIUS * (1 + 0.15 * strength * np.sin(2 * phase))
    position = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), _HEIGHT + 0.1 * strength * np.sin(swing)],
        axis=1,
    )
    yaw = angle + np.pi + np.deg2rad(8) * strength * np.sin(phase)
    pitch = np.deg2rad(-14) + np.deg2rad(7) * strength * np.sin(swing + 0.7)
    roll = np.deg2rad(3) * strength * np.sin(2 * phase)
    return looking(position, yaw, pitch, roll)


def looking(
    position: Float[np.ndarray, "n 3"],
    yaw: Float[np.ndarray, " n"],
    pitch: Float[np.ndarray, " n"],
    roll: Float[np.ndarray, " n"],
) -> Float[np.ndarray, "n 4 4"]:
    """`T_world_cam` of cameras that look along yaw and up by pitch, turned about the view by roll.

    Args:
        position: metres.
        yaw: radians from the world's x axis towards y.
        pitch: radians above the horizon.
        roll: radians.
    """
    poses = np.tile(np.eye(4), (len(position), 1, 1))
    poses[:, :3, :3] = _rotations(yaw, pitch, roll)
    poses[:, :3, 3] = position
    return poses


def along(
    corners: Float[np.ndarray, "m 2"], num_frames: int, radius: float
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " n"]]:
    """Positions at equal steps along a polyline with rounded corners, by a moving average.

    Args:
        corners: metres, from the first to the last.
        num_frames: number of positions.
        radius: half the length of the moving average, metres; about the radius of a walker's turns.

    Returns:
        Positions in metres, and the yaw of the direction of travel in radians, without jumps.
    """
    legs = np.diff(corners, axis=0)
    length = np.concatenate([[0], np.cumsum(np.linalg.norm(legs, axis=1))])
    fine = np.linspace(0, length[-1], 20 * num_frames)
    line = np.stack([np.interp(fine, length, corners[:, i]) for i in range(2)], axis=1)
    half = max(1, round(radius / (fine[1] - fine[0])))
    kernel = np.full(2 * half + 1, 1 / (2 * half + 1))
    smooth = np.stack(
        [
            np.convolve(np.pad(line[:, i], half, mode="reflect", reflect_type="odd"), kernel, "valid")
            for i in range(2)
        ],
        axis=1,
    )
    way = np.gradient(smooth, axis=0)
    travelled = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(smooth, axis=0), axis=1))])
    at = np.linspace(0, travelled[-1], num_frames)
    yaw = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
    position = np.stack([np.interp(at, travelled, smooth[:, i]) for i in range(2)], axis=1)
    return position, np.interp(at, travelled, yaw)


def poses_between(
    trajectory: Trajectory, times: Float[np.ndarray, " n"], T_cam_sensor: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n 7"]:
    """Poses at any time, by a cubic spline through a trajectory's positions and quaternions.

    Between neighbouring poses of a smooth path the normalised spline of quaternions is as smooth as one of
    rotations. Before the first and after the last pose the outermost piece goes on.

    Args:
        trajectory: `T_world_cam` in order of time.
        times: seconds.
        T_cam_sensor: pose of a sensor that moves with the camera.

    Returns:
        `T_world_sensor` as wxyz_xyz, float64.
    """
    quaternions = quaternions_from_rotations(trajectory.poses[:, :3, :3])
    # A quaternion and its negative are one rotation: each takes the sign that is nearer to the one before.
    turned = np.sum(quaternions[1:] * quaternions[:-1], axis=1) < 0
    quaternions[1:] *= np.where(np.cumsum(turned) % 2, -1, 1)[:, None]
    knots = np.concatenate([quaternions, trajectory.positions], axis=1)
    if len(knots) == 1:
        poses = np.tile(knots, (len(times), 1))
    else:
        poses = CubicSpline(trajectory.timestamps, knots)(times)
    T_world_sensor = se3.matrices_of(poses) @ T_cam_sensor
    wxyz = quaternions_from_rotations(T_world_sensor[:, :3, :3])
    return np.concatenate([wxyz, T_world_sensor[:, :3, 3]], axis=1)


def _rotations(
    yaw: Float[np.ndarray, " n"], pitch: Float[np.ndarray, " n"], roll: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Camera axes in the world: looking along yaw, up by pitch, turned about the view by roll."""
    forward = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=1)
    down = np.cross(forward, right)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=2)
