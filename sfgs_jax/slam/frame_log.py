"""Where the frames were: each relative to its keyframe, and all of them by where the keyframes are."""

from collections.abc import Sequence
from dataclasses import dataclass

import jaxlie
import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from sfgs_jax.geometry import Trajectory, se3
from sfgs_jax.slam.nodes import Edge, Keyframe
from sfgs_jax.slam.pytrees import pytree


@pytree
@dataclass(frozen=True, eq=False)
class FrameLog:
    """Where each tracked frame was, relative to the keyframe that it was registered to.

    Attributes:
        timestamps: (n,) seconds, float64.
        numbers: (n,) of the frames.
        keyframes: (n,) number of each frame's keyframe.
        motions: (n, 7) `T_keyframe_cam` as wxyz_xyz.
    """

    timestamps: Float[np.ndarray, " n"]
    numbers: Int[np.ndarray, " n"]
    keyframes: Int[np.ndarray, " n"]
    motions: Float[np.ndarray, "n 7"]

    def with_frame(self, timestamp: float, number: int, keyframe: int, motion: jaxlie.SE3) -> "FrameLog":
        """The log with one more frame."""
        return FrameLog(
            np.append(self.timestamps, timestamp),
            np.append(self.numbers, number),
            np.append(self.keyframes, keyframe),
            np.concatenate([self.motions, np.asarray(motion.wxyz_xyz)[None]]),
        )

    @property
    def newest(self) -> int:
        """Number of the last frame; -1 before the first."""
        return int(self.numbers[-1]) if len(self.numbers) else -1

    def positions(self, numbers: list[int]) -> Int[np.ndarray, " k"]:
        """Where in the log the frames of these ascending numbers are."""
        return np.flatnonzero(np.isin(self.numbers, numbers))


def trajectory_of(log: FrameLog, keyframes: Sequence[Keyframe], edges: Sequence[Edge]) -> Trajectory:
    """Poses of the frames of a log.

    On its way from one keyframe to the next a frame was tracked in the first alone. What the graph found
    since about the motion between the two is shared out among the frames between them, by their number.
    """
    if not len(log.timestamps):
        return Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    T = se3.matrices_of(np.stack([np.asarray(k.T_world_cam.wxyz_xyz) for k in keyframes]))
    poses = T[log.keyframes] @ se3.matrices_of(log.motions)
    for edge in _first_edges(edges):
        start, end = keyframes[edge.target].frame, keyframes[edge.source].frame
        between = (log.keyframes == edge.target) & (log.numbers > start) & (log.numbers < end)
        tracked = T[edge.target] @ se3.matrices_of(np.asarray(edge.T_target_source.wxyz_xyz)[None])[0]
        off = np.linalg.inv(tracked) @ T[edge.source]
        share = (log.numbers[between] - start)[:, None] / (end - start)
        correction = np.tile(np.eye(4), (len(share), 1, 1))
        turn = Rotation.from_matrix(off[:3, :3]).as_rotvec()
        correction[:, :3, :3] = Rotation.from_rotvec(share * turn).as_matrix()
        correction[:, :3, 3] = share * off[:3, 3]
        poses[between] = poses[between] @ correction
    return Trajectory(log.timestamps, poses)


def _first_edges(edges: Sequence[Edge]) -> list[Edge]:
    """Of each keyframe the edge that it was tracked by, and of two from one keyframe the earlier."""
    by_source: dict[int, Edge] = {}
    for edge in edges:
        by_source.setdefault(edge.source, edge)
    by_target: dict[int, Edge] = {}
    for edge in by_source.values():
        by_target.setdefault(edge.target, edge)
    return list(by_target.values())
