"""The hand-held camera's path through the room."""

import numpy as np

_RADIUS = 0.5
_HEIGHT = 1.35
_TURN_PER_FRAME = np.deg2rad(2.7)
"""Mean turn between frames that the path aims for, whatever the number of frames."""
_SWINGS = 3
"""How often the camera goes up and down on the way round."""


def closed_path(num_frames: int) -> np.ndarray:
    """(N, 4, 4) `T_world_cam`, smooth, the last equal to the first.

    The camera walks a circle around the room's middle and looks across it, nodding and swaying a little.
    With at least 115 frames it goes round once or more; shorter recordings swing aside and come
    back, so that the pace stays that of a hand-held camera: 2 to 3 cm and 2 to 3 degrees a frame.

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
    poses = np.tile(np.eye(4), (num_frames, 1, 1))
    poses[:, :3, :3] = _rotations(yaw, pitch, roll)
    poses[:, :3, 3] = position
    return poses


def _rotations(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Camera axes in the world: looking along yaw, up by pitch, turned about the view by roll."""
    forward = np.stack([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)], axis=1)
    right = np.stack([np.sin(yaw), -np.cos(yaw), np.zeros_like(yaw)], axis=1)
    down = np.cross(forward, right)
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=2)
