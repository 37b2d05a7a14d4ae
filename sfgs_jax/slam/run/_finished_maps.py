"""The maps of a run as it hands them out, each in the world of its own first camera."""

from dataclasses import dataclass, replace

import jax
import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.geometry import Trajectory, se3
from sfgs_jax.slam.state import SlamState, frames_by_map, maps_of, move, rows_by_recording
from sfgs_jax.splatting import Gaussians, fitted_background


@dataclass(frozen=True, eq=False)
class FinishedMap:
    """A part of a run that nothing ties to its other parts.

    Attributes:
        state: of the run.
        first: number of its first keyframe, whose camera is its world frame.
        rows: (n,) of its frames in the log.
    """

    state: SlamState
    first: int
    rows: Int[np.ndarray, " n"]

    @property
    def recordings(self) -> tuple["FinishedMap", ...]:
        """The map with the frames of each recording alone; one, unless runs were merged."""
        parts = [np.intersect1d(self.rows, rows) for rows in rows_by_recording(self.state.log)]
        return tuple(replace(self, rows=rows) for rows in parts if len(rows)) or (self,)

    @property
    def trajectory(self) -> Trajectory:
        """Poses of its frames, by where the graph has their keyframes now."""
        whole = self.state.trajectory[self.rows]
        return whole if self.first == 0 else Trajectory(whole.timestamps, self._T_own_world @ whole.poses)

    @property
    def covariances(self) -> Float[np.ndarray, "n 6 6"]:
        """Covariances of these poses: of tangents on the right, translation first, metres and radians."""
        return self.state.covariances[self.rows]

    @property
    def gains(self) -> Float[np.ndarray, "n 3"] | None:
        """Gain of each channel of its frames against the map's colours; None if they are not estimated."""
        gains = self.state.gains
        return None if gains is None else gains[self.rows]

    @property
    def background(self) -> Float[np.ndarray, "9 3"] | None:
        """Colours behind the map: what its views show by direction, in its exposure; None without views."""
        numbers = self.state.log.numbers[self.rows].tolist()
        poses = dict(zip(numbers, self.trajectory.poses.astype(np.float32), strict=True))
        views = [view for view in self.state.mapping.views if view.frame in poses and np.any(view.valid)]
        if not views:
            return None
        mean = np.mean([view.gain for view in self.state.mapping.views], axis=0)

        images = (
            (
                np.asarray(view.rgb, np.float32) * np.asarray(mean / view.gain / 255, np.float32),
                np.asarray(view.valid),
                poses[view.frame],
            )
            for view in views
        )
        return fitted_background(images, self.state.mapping_camera)

    @property
    def keyframe_trajectory(self) -> Trajectory:
        """Poses of the frames that the map was made from."""
        views = sorted(view.frame for view in self.state.mapping.views)
        return self.trajectory[np.isin(self.rows, self.state.log.positions(views))]

    @property
    def gaussians(self) -> Gaussians:
        """Its Gaussians."""
        mapping, maps = self.state.mapping, maps_of(self.state.graph)
        if not maps.any():
            return self.state.gaussians
        poses = mapping.keyframe_poses
        moved = se3.parameters_of(self._T_own_world @ se3.matrices_of(poses)).astype(poses.dtype)
        whole = mapping.whole
        gaussians = (move(whole, poses, moved) if self.first else whole).gaussians
        own = np.asarray(gaussians.valid) & (maps[np.asarray(whole.keyframes)] == self.first)
        return replace(gaussians, valid=jax.device_put(own))

    @property
    def _T_own_world(self) -> Float[np.ndarray, "4 4"]:
        return np.linalg.inv(se3.matrices_of(self.state.graph.poses[[self.first]])[0].astype(np.float64))


def maps_of_run(state: SlamState) -> tuple[FinishedMap, ...]:
    """The maps of a run, that of most frames first; an empty one before the first frame.

    Args:
        state: of the run.
    """
    parts = frames_by_map(state.log, state.graph) or [(0, np.zeros(0, int))]
    return tuple(FinishedMap(state, first, rows) for first, rows in parts)
