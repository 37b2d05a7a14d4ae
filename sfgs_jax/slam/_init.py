"""The state before the first frame."""

import math
from dataclasses import replace

import numpy as np

from sfgs_jax.arrays import checked_but
from sfgs_jax.geometry import Camera, require_camera
from sfgs_jax.sensors import FrameClock, SensorModel, block_means
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import depth_parameters_in_use, estimated_timing, init_tracker, tracker_params
from sfgs_jax.slam.keyframes import prior_noise, with_new_depth_parameters
from sfgs_jax.slam.state import (
    SlamState,
    empty_graph,
    empty_log,
    empty_map_state,
    empty_synchrony,
    mapping_camera,
)


@checked_but("camera")
def init(camera: Camera, config: SlamConfig | None = None, sensors: SensorModel | None = None) -> SlamState:
    """The state before the first frame, whose camera will be the world frame.

    Args:
        camera: intrinsics of the frames; their size is fixed for the run.
        config: settings.
        sensors: what is known about the camera, for example from `read_sensors` after an earlier run; the
            estimates begin there.

    Raises:
        InputError: times or a correction of depth are given that the settings leave without effect.
    """
    require_camera(camera)
    config = config or SlamConfig()
    params = tracker_params(camera, config.tracking, sensors)
    tracker = init_tracker(params)
    size = tracker.references.keypoints.signature.shape[-1]
    graph = empty_graph(depth_parameters_in_use(params), prior_noise(config.graph), size)
    graph = with_new_depth_parameters(params, graph)
    if config.tracking.estimate_timing:
        _, covariance = estimated_timing(params, tracker)
        graph = replace(graph, times_covariance=np.asarray(covariance, np.float64))
    views = mapping_camera(camera, config.mapping)
    return SlamState(
        config=config,
        params=params,
        tracker=tracker,
        graph=graph,
        mapping=empty_map_state(
            config.mapping, pixels=math.prod(views.shape), timed=config.tracking.estimate_timing
        ),
        log=empty_log(),
        next_frame=0,
        clock=FrameClock(),
        last_view=0,
        last_look=block_means(np.zeros((*camera.shape, 3), np.float32)),
        synchrony=empty_synchrony(camera),
        num_lost=0,
    )
