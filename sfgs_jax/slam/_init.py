"""The state before the first frame."""

from sfgs_jax.geometry import Camera
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import init_tracker, tracker_params
from sfgs_jax.slam.state import SlamState, empty_graph, empty_log, empty_map_state


def init(camera: Camera, config: SlamConfig | None = None) -> SlamState:
    """The state before the first frame, whose camera will be the world frame.

    Args:
        camera: intrinsics of the frames; their size is fixed for the run.
        config: settings.
    """
    config = config or SlamConfig()
    params = tracker_params(camera, config.tracking)
    return SlamState(
        config=config,
        params=params,
        tracker=init_tracker(params),
        graph=empty_graph(),
        mapping=empty_map_state(config.mapping),
        log=empty_log(),
        next_frame=0,
        last_timestamp=float("nan"),
        last_view=0,
        num_lost=0,
    )
