"""The state of a run: tracker, keyframe graph, map and frame log."""

from dataclasses import dataclass, field

import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import Text, printed_fields, printed_length, pytree
from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.sensors import FrameClock
from sfgs_jax.slam.config import MappingConfig, SlamConfig
from sfgs_jax.slam.state._frame_log import FrameLog, covariances_of, trajectory_of
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._map_state import MapState
from sfgs_jax.slam.state._synchrony import Synchrony
from sfgs_jax.slam.state._tracker import Tracker, TrackerParams
from sfgs_jax.slam.state._view_estimates import corrections_of, gains_of
from sfgs_jax.splatting import Gaussians


@pytree
@dataclass(frozen=True, eq=False)
class SlamState:
    """Everything a run knows; each field is replaced, never changed in place.

    Attributes:
        config: settings; static.
        params: parameters of tracking, the camera among them.
        tracker: pose and motion of the newest frame, and the references it is tracked in.
        graph: keyframes and the registrations between them.
        mapping: the map and its views.
        log: poses of the tracked frames.
        next_frame: number that the next frame gets if its source gives none.
        clock: of the frames, by their time stamps.
        last_view: number of the newest frame that became a view of the map.
        last_look: (h, w, 3) mean colours of the newest tracked frame, by blocks; see `sensors.block_means`.
        synchrony: what the newest frames say about the time between depth and colour.
        num_lost: frames that were not found.
    """

    config: SlamConfig = field(metadata={"static": True})
    params: TrackerParams
    tracker: Tracker
    graph: KeyframeGraph
    mapping: MapState
    log: FrameLog
    next_frame: int
    clock: FrameClock
    last_view: int
    last_look: Float[np.ndarray, "h w 3"]
    synchrony: Synchrony
    num_lost: int

    def __repr__(self) -> str:
        return printed_fields(
            "SlamState",
            camera=Text(repr(self.camera)),
            tracked=Text(printed_length(self.log.timestamps)),
            lost=self.num_lost,
            graph=Text(repr(self.graph)),
            mapping=Text(repr(self.mapping)),
        )

    @property
    def camera(self) -> Camera:
        """Intrinsics of the frames."""
        return self.params.camera

    @property
    def mapping_camera(self) -> Camera:
        """Intrinsics of the views' images."""
        return mapping_camera(self.camera, self.config.mapping)

    @property
    def row_times(self) -> Float[np.ndarray, "3"] | None:
        """Times of the camera's rows as estimated, in the order of `SensorTiming`; None if they are not."""
        timed = self.config.tracking.estimate_timing
        return self.tracker.last_motion.timing.on_host() if timed else None

    @property
    def last_timestamp(self) -> float:
        """Time stamp of the newest frame, seconds; NaN before the first."""
        return self.clock.stamp if self.clock.count else float("nan")

    @property
    def T_world_cam(self) -> jaxlie.SE3:
        """Pose of the newest tracked frame; the identity before the first."""
        return self.tracker.T_world_cam

    @property
    def gaussians(self) -> Gaussians:
        """The map, with what of it is paged out."""
        return self.mapping.whole.gaussians

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the tracked frames, by where their keyframes are now, corrected by the views' images."""
        tracked = trajectory_of(self.log, self.graph)
        corrections = se3.exps_of(corrections_of(self.log, self.mapping.views))
        return Trajectory(tracked.timestamps, tracked.poses @ corrections)

    @property
    def covariances(self) -> Float[np.ndarray, "n 6 6"]:
        """Covariances of these poses: of tangents on the right, translation first, metres and radians."""
        return covariances_of(self.log, self.graph)

    @property
    def gains(self) -> Float[np.ndarray, "n 3"] | None:
        """Gain of each channel of the tracked frames against the map's colours; see `sensors.fitted_gain`.

        Those of the views are fitted. The others follow from them by the change of brightness from frame to
        frame. None if they are not estimated.
        """
        if not self.config.mapping.optimisation.estimate_exposure:
            return None
        return gains_of(self.log, self.mapping.views)


def mapping_factor(camera: Camera, config: MappingConfig) -> int:
    """Whole factor by which the images of views are reduced.

    Args:
        camera: intrinsics of the frames.
        config: settings.
    """
    return max(1, -(-camera.width // config.max_width))


def mapping_camera(camera: Camera, config: MappingConfig) -> Camera:
    """Intrinsics of the views' images.

    Args:
        camera: intrinsics of the frames.
        config: settings.
    """
    return camera.downscaled(mapping_factor(camera, config))
