"""Motions of given poses beside those of the images, and how far they differ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.evaluation.recording_check._frame_pairs import PairMotion
from sfgs_jax.geometry import Trajectory, rotation_vectors

LEAST_TURN = np.radians(1.5)
"""Angle of a smaller turn, which has no axis to speak of."""

LEAST_SHARE = 0.3
"""Share of the matches that agree with a motion; with a smaller one it is not believed."""

_LEAST_MOVE = 0.03
"""Length of a translation as a share of the scene's depth; a shorter one has no direction."""
_LARGEST_BEND = np.radians(60)
"""Angle between directions that counts as no agreement at all."""


@dataclass(frozen=True)
class Convention:
    """What the given poses are in place of `T_world_cam` in OpenCV's axes.

    Attributes:
        inverse: world to camera.
        axes: signed permutation that takes vectors of the given camera's axes to OpenCV's.
    """

    inverse: bool
    axes: Float[np.ndarray, "3 3"]

    def motions(
        self, first: Float[np.ndarray, "n 4 4"], second: Float[np.ndarray, "n 4 4"]
    ) -> Float[np.ndarray, "n 4 4"]:
        """`T_second_first` of cameras in OpenCV's axes, of two poses each."""
        moved = second @ np.linalg.inv(first) if self.inverse else np.linalg.inv(second) @ first
        change = np.eye(4)
        change[:3, :3] = self.axes
        return change @ moved @ change.T


AS_GIVEN = Convention(inverse=False, axes=np.eye(3))


@dataclass(frozen=True)
class PoseScale:
    """Length of motions by depth in that of the same motions by poses.

    Attributes:
        ratio: 1 where depth and poses have one unit.
        relative_error: standard error of the ratio's logarithm.
        count: motions that were compared.
    """

    ratio: float
    relative_error: float
    count: int


@dataclass(frozen=True)
class PoseMotions:
    """Pairs of frames with poses.

    Attributes:
        first: given pose of the first frame.
        second: given pose of the second frame.
        measured: `T_second_first` by keypoints and depth.
        moving: pairs with a translation that has a direction.
    """

    first: Float[np.ndarray, "n 4 4"]
    second: Float[np.ndarray, "n 4 4"]
    measured: Float[np.ndarray, "n 4 4"]
    moving: Bool[np.ndarray, " n"]

    def unexplained(self, convention: Convention) -> float:
        """Share of the motion that poses leave over: 0 for exact ones, 1 for those of another recording.

        Args:
            convention: how to read the poses.
        """
        given = convention.motions(self.first, self.second)
        turns = np.linalg.norm(_rotation_logs(self.measured), axis=1)
        over = np.linalg.norm(_rotation_logs(given @ np.linalg.inv(self.measured)), axis=1)
        turning = turns > LEAST_TURN
        parts = []
        if turning.any():
            parts.append(float(np.median(np.minimum(over[turning] / turns[turning], 1))))
        if self.moving.any():
            # Where a frame's pose is a little off, its direction suffers, not so its place on the whole.
            bend = _angles(given[self.moving, :3, 3], self.measured[self.moving, :3, 3])
            parts.append(float(np.median(np.minimum(bend / _LARGEST_BEND, 1))))
        return float(np.mean(parts)) if parts else float("nan")

    def scale(self, convention: Convention) -> PoseScale | None:
        """Length of measured motions in given ones; None if too few have one.

        Args:
            convention: how to read the poses.
        """
        given = np.linalg.norm(convention.motions(self.first, self.second)[:, :3, 3], axis=1)
        lengths = np.linalg.norm(self.measured[:, :3, 3], axis=1)
        used = self.moving & (given > 0)
        if np.count_nonzero(used) < 4:
            return None
        logs = np.log(lengths[used] / given[used])
        middle = float(np.median(logs))
        spread = 1.5 * float(np.median(np.abs(logs - middle)))
        return PoseScale(float(np.exp(middle)), spread / float(np.sqrt(len(logs) / 2)), len(logs))


def poses_by_frame(truth: Trajectory, timestamps: Float[np.ndarray, " n"]) -> dict[int, np.ndarray]:
    """Given poses by the numbers of their frames.

    Args:
        truth: poses at time stamps of frames.
        timestamps: of all frames.
    """
    by_time = dict(zip(truth.timestamps.tolist(), truth.poses, strict=True))
    return {i: by_time[time] for i, time in enumerate(timestamps.tolist()) if time in by_time}


def pose_motions(
    poses: Mapping[int, np.ndarray],
    motions: Sequence[PairMotion],
    *,
    lag: int = 0,
) -> PoseMotions:
    """Given poses of the pairs that have them.

    Args:
        poses: by numbers of frames.
        motions: of matched frames.
        lag: take the poses of frames so many places later.
    """
    first, second, measured, moving = [], [], [], []
    for pair, motion in motions:
        a, b = pair.first.index + lag, pair.second.index + lag
        if a in poses and b in poses and motion.share > LEAST_SHARE:
            first.append(poses[a])
            second.append(poses[b])
            measured.append(motion.T_second_first)
            length = np.linalg.norm(motion.T_second_first[:3, 3])
            moving.append(length > _LEAST_MOVE * np.median(motion.points[:, 2]))
    shape = (-1, 4, 4)
    return PoseMotions(
        np.reshape(first, shape),
        np.reshape(second, shape),
        np.reshape(measured, shape),
        np.array(moving, bool),
    )


def _rotation_logs(T: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
    return rotation_vectors(T[:, :3, :3])


def _angles(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), np.sum(a * b, axis=1))
