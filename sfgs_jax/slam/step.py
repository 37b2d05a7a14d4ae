"""One step of a run: track the frame, advance the graph of keyframes, update the map.

This file holds the order of things. `track`, `adjust` and `map_step` are compiled pure functions; the host
decides what happens next, and lets arrays grow.
"""

import warnings
from dataclasses import replace
from typing import NamedTuple

from sfgs_jax.arrays import checked_but
from sfgs_jax.geometry import Frame, warn_unless_metres, warn_unless_unit_colours
from sfgs_jax.slam._frame_brightness import look_of
from sfgs_jax.slam._frame_check import check_frame
from sfgs_jax.slam._frame_pose import find_pose
from sfgs_jax.slam._graph_results import with_graph
from sfgs_jax.slam.frontend import with_corrected_depth
from sfgs_jax.slam.keyframes import (
    Registrations,
    advance_graph,
    with_new_keyframes,
    with_pairs_of_known_motion,
)
from sfgs_jax.slam.mapping import becomes_extra_view, becomes_view, map_frame, view_of
from sfgs_jax.slam.state import (
    SlamState,
    Stages,
    StepInfo,
    View,
    mapping_factor,
    newest_covariance,
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


@checked_but("frame")
def step(
    state: SlamState, frame: Frame, *, number: int | None = None, stages: Stages = untimed
) -> tuple[SlamState, StepInfo]:
    """Process one frame: its pose, then the graph of keyframes, then the map.

    The work is done by compiled functions; the first frames of an image size wait for their compilation, or
    `warm_up` does it before. It runs on the host; inside `jit`, `scan` or `vmap` use `track`.

    Warns if the first frame's depth is not in metres by its median, or its colours are not in [0, 1]. Warns
    too if depth contradicts colour or the frames before; then frames are lost.

    Args:
        state: the run so far, from `init` or an earlier step.
        frame: the next frame, of the camera's size.
        number: its number in its source; one more than that of the frame before if not given.
        stages: times the stages `tracking`, `graph`, `view` and `mapping`.

    Raises:
        InputError: the frame has another size than the camera.
        FrameError: its time stamp is before that of the last frame, or more than an hour after it.
    """
    if isinstance(frame, Frame) and not len(state.log.timestamps):
        warn_unless_metres(frame.depth)
        warn_unless_unit_colours(frame.rgb)
    state, info, view = follow(state, frame, number=number, stages=stages)
    if info.contradiction:
        warnings.warn(info.contradiction, stacklevel=2)
    if not info.tracked:
        return state, info
    mapping, loss = map_frame(state.mapping, state, view, stages=stages)
    return replace(state, mapping=mapping), info._replace(loss=loss)


@checked_but("frame")
def follow(
    state: SlamState,
    frame: Frame,
    *,
    number: int | None = None,
    stages: Stages = untimed,
    registrations: Registrations | None = None,
) -> Followed:
    """Find a frame's pose and bring the graph up to date; the map is left to its owner.

    Args:
        state: as of `step`, which has the same errors.
        frame: likewise.
        number: likewise.
        stages: likewise.
        registrations: those of the run's keyframes that no frame waits for, begun by the caller between
            two frames; if not given, this one waits.
    """
    check_frame(frame, state.camera, state.last_timestamp)
    number, time = state.next_frame if number is None else number, float(frame.timestamp)
    params, config, before = state.params, state.config.graph, state
    registrations = registrations or Registrations()
    if registrations.are_awaited and _newest_is_tracked(before):
        ready = with_pairs_of_known_motion(params, before.graph, before.log.newest)
        registrations.begin(params, ready, config)
    with stages("tracking"):
        state, found, info, covariance, by_lag = find_pose(state, frame, number)
    if found is None:
        return Followed(state, info, None)

    with stages("graph"):
        frames = (before.log.newest, number)
        graph = with_new_keyframes(params, before.graph, before.tracker, found, frames, config)
        grown = len(graph.keyframes) > len(before.graph.keyframes)
        graph, closed = advance_graph(params, graph, config, grown=grown, registered=registrations.take())
        state = with_graph(state, graph)
    keyframe, T_keyframe_cam = int(found.info.reference), found.info.T_reference_cam
    if info.new_keyframe:
        # The tracker's identity is there already. A new one would wait for what the device computes.
        keyframe, T_keyframe_cam = len(graph.keyframes) - 1, found.tracker.T_reference_cam
        covariance = by_lag
    look, brighter = look_of(state, frame, keyframe, T_keyframe_cam)
    log = state.log.with_frame(time, number, keyframe, T_keyframe_cam, covariance, brighter)
    view = None
    due = becomes_view(state, log, frame, new_keyframe=info.new_keyframe)
    if due or becomes_extra_view(state.mapping, number, state.last_view, state.config.mapping):
        factor = mapping_factor(state.camera, state.config.mapping)
        corrected, twist = with_corrected_depth(params, frame), state.tracker.last_motion.twist
        view = view_of(corrected, factor, keyframe, T_keyframe_cam, number, twist, extra=not due)
    last_view = number if due else state.last_view
    state = replace(state, log=log, last_view=last_view, last_look=look)
    covariance = newest_covariance(log, graph)
    info = info._replace(T_world_cam=state.T_world_cam, covariance=covariance)
    info = info._replace(new_view=due, loop_closed=closed)
    return Followed(state, info, view)


def _newest_is_tracked(state: SlamState) -> bool:
    """True if the newest frame was tracked: then the next one probably will be.

    A lost frame leaves the graph alone: registrations begun for it would be made again for the next.
    """
    return state.log.newest == state.next_frame - 1
