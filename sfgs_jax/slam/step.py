"""One step of a run: track the frame, advance the graph of keyframes, update the map.

This file holds the order of things. `track`, `adjust` and `map_step` are compiled pure functions; the host
decides what happens next, and lets arrays grow.
"""

import warnings
from dataclasses import replace
from typing import NamedTuple

import jax
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Frame, se3, warn_unless_metres
from sfgs_jax.slam._frame_brightness import look_of
from sfgs_jax.slam._frame_check import check_frame
from sfgs_jax.slam._graph_results import with_graph
from sfgs_jax.slam.frontend import (
    Found,
    TrackInfo,
    find_frame,
    lost_unseen,
    watched,
    with_corrected_depth,
)
from sfgs_jax.slam.keyframes import advance_graph, motion_covariance, revisited, with_new_keyframes
from sfgs_jax.slam.mapping import becomes_view, map_frame, view_of
from sfgs_jax.slam.state import (
    PoseSource,
    SlamState,
    Stages,
    StepInfo,
    Tracker,
    View,
    covariances_of,
    lost_info,
    mapping_factor,
    untimed,
)


class Followed(NamedTuple):
    """Result of following a frame: everything but the map.

    Attributes:
        state: the run with the frame.
        info: what happened.
        view: the frame as a view for the map, if it is one.
    """

    state: SlamState
    info: StepInfo
    view: View | None


def step(
    state: SlamState, frame: Frame, *, number: int | None = None, stages: Stages = untimed
) -> tuple[SlamState, StepInfo]:
    """Process one frame: its pose, then the graph of keyframes, then the map.

    The work is done by compiled functions; the first frames of an image size wait for their compilation, or
    `warm_up` does it before. It runs on the host; inside `jit`, `scan` or `vmap` use `track`.

    Warns if the first frame's depth is not in metres by its median, and if depth contradicts colour or the
    frames before; then frames are lost.

    Args:
        state: the run so far, from `init` or an earlier step.
        frame: the next frame, of the camera's size.
        number: its number in its source; one more than that of the frame before if not given.
        stages: times the stages `tracking`, `graph`, `view` and `mapping`.

    Raises:
        InputError: the frame has another size than the camera.
        FrameError: its time stamp is before that of the last frame.
    """
    if isinstance(frame, Frame) and not len(state.log.timestamps):
        warn_unless_metres(frame.depth)
    state, info, view = follow(state, frame, number=number, stages=stages)
    if info.contradiction:
        warnings.warn(info.contradiction, stacklevel=2)
    if not info.tracked:
        return state, info
    mapping, loss = map_frame(state.mapping, state, view, stages=stages)
    return replace(state, mapping=mapping), info._replace(loss=loss)


def follow(
    state: SlamState, frame: Frame, *, number: int | None = None, stages: Stages = untimed
) -> Followed:
    """Find a frame's pose and bring the graph up to date; the map is left to its owner.

    Arguments and errors as of `step`.
    """
    check_frame(frame, state.camera, state.last_timestamp)
    number, time = state.next_frame if number is None else number, float(frame.timestamp)
    params, config, since = state.params, state.config.graph, time - state.last_timestamp
    with stages("tracking"):
        synchrony = watched(state.synchrony, frame, params.config.max_depth_lag)
        state = replace(state, synchrony=synchrony)
        if synchrony.lag:
            return _out_of_step(state, number, time)
        found = find_frame(params, state.tracker, frame, since, state.graph, config)
        found = revisited(params, found, state.graph, config)
        tracker, info = found.tracker, _info(found)
    before, state = state, replace(state, tracker=tracker, next_frame=number + 1, last_timestamp=time)
    if not info.tracked:
        state = replace(state, num_lost=state.num_lost + 1)
        told = _contradiction(found.info, tracker)
        return Followed(state, info._replace(T_world_cam=state.T_world_cam, contradiction=told), None)

    with stages("graph"):
        frames = (before.log.newest, number)
        graph = with_new_keyframes(params, before.graph, before.tracker, found, frames, config)
        grown = len(graph.keyframes) > len(before.graph.keyframes)
        graph, closed = advance_graph(params, graph, config, grown=grown)
        state = with_graph(state, graph)
    keyframe, T_keyframe_cam, covariance = _place_in_graph(state, found.info, info)
    look, brighter = look_of(state, frame, keyframe, T_keyframe_cam)
    log = state.log.with_frame(time, number, keyframe, T_keyframe_cam, covariance, brighter)
    view = None
    if becomes_view(state, log, frame, new_keyframe=info.new_keyframe):
        factor = mapping_factor(state.camera, state.config.mapping)
        corrected, twist = with_corrected_depth(params, frame), tracker.last_motion.twist
        view = view_of(corrected, factor, keyframe, T_keyframe_cam, number, twist)
    last_view = state.last_view if view is None else number
    state = replace(state, log=log, last_view=last_view, last_look=look)
    covariance = covariances_of(log, graph, slice(-1, None))[0]
    info = info._replace(T_world_cam=state.T_world_cam, covariance=covariance)
    info = info._replace(new_view=view is not None, loop_closed=closed)
    return Followed(state, info, view)


def _out_of_step(state: SlamState, number: int, time: float) -> Followed:
    """The run after a frame whose depth is of another time than its colour."""
    since, lag = time - state.last_timestamp, state.synchrony.lag
    tracker = lost_unseen(state.tracker, since if 0 < since < np.inf else 0)
    state = replace(
        state, tracker=tracker, next_frame=number + 1, last_timestamp=time, num_lost=state.num_lost + 1
    )
    told = f"Depth comes {abs(lag)} frames {'late' if lag > 0 else 'early'} against colour."
    return Followed(state, lost_info(state.T_world_cam)._replace(contradiction=told), None)


def _contradiction(info: TrackInfo, tracker: Tracker) -> str:
    """Why a lost frame's depth is not believed; empty if nothing speaks against it."""
    if not bool(tracker.doubtful_scale):
        return ""
    change = -100 * float(info.registration.scale_change)
    word = "longer" if change > 0 else "shorter"
    return f"Depth is about {abs(change):.0f} % {word} than in the frames before."


def _info(ladder: Found) -> StepInfo:
    """The report once a frame has been tracked; one transfer from the device."""
    found, by = ladder.info, ladder.info.registration
    wanted = (found.source, found.new_keyframe, by.inlier_fraction, by.rmse, by.matched.num_matches)
    source, new_keyframe, fraction, rmse, matches, inliers = jax.device_get((*wanted, by.matched.num_inliers))
    return StepInfo(
        T_world_cam=found.T_world_cam,
        covariance=np.diag(np.full(6, np.inf)),
        tracked=int(source) != PoseSource.LOST,
        source=PoseSource(int(source)),
        relocalised=ladder.by_looks,
        new_keyframe=bool(new_keyframe),
        new_map=ladder.begins_map,
        new_view=False,
        loop_closed=False,
        inlier_fraction=float(fraction),
        rmse=float(rmse),
        num_matches=int(matches),
        num_inliers=int(inliers),
        loss=float("nan"),
    )


def _place_in_graph(
    state: SlamState, found: TrackInfo, info: StepInfo
) -> tuple[int, jaxlie.SE3, Float[np.ndarray, "6 6"]]:
    """Number of the keyframe that the frame belongs to, its pose there, and the covariance of that."""
    if info.new_keyframe:
        return len(state.graph.keyframes) - 1, se3.identity(), np.zeros((6, 6))
    free_sigma = state.config.tracking.motion_model_sigma
    covariance = motion_covariance(found.registration, state.graph.noise, free_sigma)
    return int(found.reference), found.T_reference_cam, covariance
