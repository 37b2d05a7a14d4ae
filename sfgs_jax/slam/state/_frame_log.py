"""Log of the tracked frames: each one's pose in its keyframe, and from these the trajectory."""

from collections.abc import Iterator
from dataclasses import dataclass

import jaxlie
import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.arrays import Text, appended, printed_fields, printed_length, pytree
from sfgs_jax.geometry import Trajectory, se3, slerp
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph


@pytree
@dataclass(frozen=True, eq=False)
class FrameLog:
    """Poses of the tracked frames, each in the keyframe that it was registered to.

    Attributes:
        timestamps: (n,) seconds, float64.
        numbers: (n,) of the frames.
        keyframes: (n,) number of each frame's keyframe.
        motions: (n, 7) `T_keyframe_cam` as wxyz_xyz.
        covariances: (n, 6, 6) of their tangents.
        brightness: (n, 3) logarithm of each channel's brightness, up to a constant; it drifts, for it is
            summed from frame to frame.
    """

    timestamps: Float[np.ndarray, " n"]
    numbers: Int[np.ndarray, " n"]
    keyframes: Int[np.ndarray, " n"]
    motions: Float[np.ndarray, "n 7"]
    covariances: Float[np.ndarray, "n 6 6"]
    brightness: Float[np.ndarray, "n 3"]

    def __repr__(self) -> str:
        return printed_fields("FrameLog", frames=Text(printed_length(self.timestamps)))

    def with_frame(
        self,
        timestamp: float,
        number: int,
        keyframe: int,
        motion: jaxlie.SE3,
        covariance: Float[np.ndarray, "6 6"],
        brighter: Float[np.ndarray, "3"] | float = 0.0,
    ) -> "FrameLog":
        """The log with one more frame.

        Args:
            timestamp: seconds.
            number: of the frame in its source.
            keyframe: number of its keyframe.
            motion: `T_keyframe_cam`.
            covariance: of its tangent.
            brighter: change of each channel's logarithm from the frame before.
        """
        last = self.brightness[-1:] if len(self.brightness) else np.zeros((1, 3), np.float32)
        return FrameLog(
            appended(self.timestamps, np.asarray([timestamp])),
            appended(self.numbers, np.asarray([number])),
            appended(self.keyframes, np.asarray([keyframe])),
            appended(self.motions, np.asarray(motion.wxyz_xyz)[None]),
            appended(self.covariances, np.asarray(covariance)[None]),
            appended(self.brightness, last + np.float32(brighter)),
        )

    @property
    def newest(self) -> int:
        """Number of the last frame; -1 before the first."""
        return int(self.numbers[-1]) if len(self.numbers) else -1

    def positions(self, numbers: list[int]) -> Int[np.ndarray, " k"]:
        """Rows of the log that hold the frames of these numbers.

        Args:
            numbers: of frames, ascending.
        """
        return np.flatnonzero(np.isin(self.numbers, numbers))


def trajectory_of(log: FrameLog, graph: KeyframeGraph) -> Trajectory:
    """Poses of the frames of a log, by where their keyframes are now.

    Frames between two keyframes were tracked in the first alone. The graph's correction of the motion between
    the two is shared out among them, in proportion to their numbers.

    Args:
        log: the frames.
        graph: their keyframes.
    """
    if not len(log.timestamps):
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    T = se3.matrices_of(graph.poses)
    poses = T[log.keyframes] @ se3.matrices_of(log.motions)
    for between, share, off in _corrections(log, graph):
        correction = np.tile(np.eye(4), (len(share), 1, 1))
        turn = np.broadcast_to(off[:3, :3], (len(share), 3, 3))
        correction[:, :3, :3] = slerp(correction[:, :3, :3], turn, share[:, None])
        correction[:, :3, 3] = share[:, None] * off[:3, 3]
        poses[between] = poses[between] @ correction
    return Trajectory(log.timestamps, poses)


def newest_covariance(log: FrameLog, graph: KeyframeGraph) -> Float[np.ndarray, "6 6"]:
    """Covariance of the newest frame's `T_world_cam`, of its tangent, as the graph knows its keyframe now.

    Args:
        log: the frames.
        graph: their keyframes.
    """
    motion = se3.matrices_of(log.motions[-1:])
    known = graph.total_covariances(log.keyframes[-1:])
    return se3.composed_covariances(known, motion, log.covariances[-1:])[0]


def covariances_of(log: FrameLog, graph: KeyframeGraph) -> Float[np.ndarray, "n 6 6"]:
    """Covariances of the frames' `T_world_cam`, of their tangents, as the graph knows their keyframes now.

    Nobody knows where between two keyframes tracking drifted. A frame between them has the variance of a
    random walk with known ends, in all directions, as wide as the graph's correction.

    Args:
        log: the frames.
        graph: their keyframes.
    """
    own = log.covariances.astype(np.float64)
    for between, share, off in _corrections(log, graph):
        walked = se3.logs_of(off[None])[0].reshape(2, 3)
        variance = np.repeat(np.mean(walked**2, axis=1), 3)
        own[between] += (share * (1 - share))[:, None, None] * np.diag(variance)
    known = graph.total_covariances(log.keyframes)
    return se3.composed_covariances(known, se3.matrices_of(log.motions), own)


def _corrections(
    log: FrameLog, graph: KeyframeGraph
) -> Iterator[tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " k"], Float[np.ndarray, "4 4"]]]:
    """Frames between two keyframes, their shares of the way, and the graph's correction of that way."""
    T = se3.matrices_of(graph.poses)
    for reference, number in _successors(graph).items():
        keyframe = graph.keyframes[number]
        start, end = graph.keyframes[reference].frame, keyframe.frame
        between = (log.keyframes == reference) & (log.numbers > start) & (log.numbers < end)
        tracked = T[reference] @ se3.matrices_of(keyframe.T_reference_keyframe[None])[0]
        share = (log.numbers[between] - start) / (end - start)
        yield between, share, np.linalg.inv(tracked) @ T[number]


def _successors(graph: KeyframeGraph) -> dict[int, int]:
    """The earliest keyframe that was tracked in each keyframe."""
    found: dict[int, int] = {}
    for number, keyframe in enumerate(graph.keyframes):
        if keyframe.reference != number:
            found.setdefault(keyframe.reference, number)
    return found


def empty_log() -> FrameLog:
    """The log before the first frame."""
    return FrameLog(
        np.zeros(0),
        np.zeros(0, np.int64),
        np.zeros(0, np.int64),
        np.zeros((0, 7), np.float32),
        np.zeros((0, 6, 6), np.float32),
        np.zeros((0, 3), np.float32),
    )
