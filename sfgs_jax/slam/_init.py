"""The state before the first frame."""

from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import init_tracker, offsets_in_use, tracker_params
from sfgs_jax.slam.state import SlamState, empty_graph, empty_log, empty_map_state


def init(camera: Camera, config: SlamConfig | None = None, timing: SensorTiming | None = None) -> SlamState:
    """The state before the first frame, whose camera will be the world frame.

    Args:
        camera: intrinsics of the frames; their size is fixed for the run.
        config: settings.
        timing: times of the camera's rows as known before the first frame, for example from
            `estimated_timing` after an earlier run of the same camera; all rows at once if not given.

    Raises:
        InputError: times are given while `TrackingConfig.estimate_timing` is off.
    """
    config = config or SlamConfig()
    params = tracker_params(camera, config.tracking, timing)
    return SlamState(
        config=config,
        params=params,
        tracker=init_tracker(params),
        graph=empty_graph(offsets_in_use(params)),
        mapping=empty_map_state(config.mapping),
        log=empty_log(),
        next_frame=0,
        last_timestamp=float("nan"),
        last_view=0,
        num_lost=0,
    )
