"""One step of the system: find the frame, take keyframes, advance the graph, advance the map."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import NamedTuple

import jaxlie
import numpy as np

from sfgs_jax.geometry import Frame, se3
from sfgs_jax.slam.graph import edge_of, is_edge, neighbours, optimise_poses, register_pair
from sfgs_jax.slam.loops import believe, is_candidate, loop_pairs, with_candidate
from sfgs_jax.slam.mapping import follow_keyframes, insert_view, optimise_once, view_of, warm_up
from sfgs_jax.slam.nodes import Keyframe
from sfgs_jax.slam.observation import Observation, observe
from sfgs_jax.slam.registration import Carrier, extent, register
from sfgs_jax.slam.state import MapState, SlamState, View
from sfgs_jax.slam.tracking import Tracking, has_left, motion_since, relocalise, search, track
from sfgs_jax.slam.window import optimise_window, share_landmarks

Stages = Callable[[str], AbstractContextManager[None]]
"""Gives, for the name of a stage, a context that lasts as long as the stage and times it."""


class StepInfo(NamedTuple):
    """What happened in a step.

    Attributes:
        T_world_cam: the frame's pose; the last known one where it was lost.
        tracked: whether that pose is known.
        carrier: what it rests on: keypoints, surface, both, or the motion model in part.
        relocalised: the frame was found again after it, or those before it, had been lost.
        new_keyframe: the frame became a node of the graph.
        new_view: the frame became a view of the map.
        loop_closed: a loop was closed in this step.
        inlier_fraction: share of the frame's points that lie on the reference's surface.
        rmse: root mean square distance of those, metres.
        num_matches: keypoints matched with the reference's.
        num_inliers: matches that agree with the motion found.
        loss: of the map on the view last rendered, before the step on it; nan if none was.
    """

    T_world_cam: jaxlie.SE3
    tracked: bool
    carrier: Carrier
    relocalised: bool
    new_keyframe: bool
    new_view: bool
    loop_closed: bool
    inlier_fraction: float
    rmse: float
    num_matches: int
    num_inliers: int
    loss: float


class Followed(NamedTuple):
    """What following a frame gave: all but the map.

    Attributes:
        state: the run with the frame.
        info: what happened.
        view: what the map should learn from, if anything.
    """

    state: SlamState
    info: StepInfo
    view: View | None


def untimed(name: str) -> AbstractContextManager[None]:
    """Stages that nobody times."""
    return nullcontext()


def step(state: SlamState, frame: Frame, *, stages: Stages = untimed) -> tuple[SlamState, StepInfo]:
    """Process one frame: its pose, then the graph of keyframes, then the map.

    The work is done by jit-compiled functions, compiled once per image size and map capacity; the first
    frame compiles them all.

    Args:
        state: the run so far, from `init` or an earlier step.
        frame: the next frame, of the size that the camera has.
        stages: times the stages `tracking`, `graph`, `view` and `mapping`.

    Raises:
        ValueError: the frame has another size than the camera.
    """
    state, info, view = follow(state, frame, stages=stages)
    mapping, loss = advance_map(state, state.mapping, view, tracked=info.tracked, stages=stages)
    return replace(state, mapping=mapping), info._replace(loss=loss)


def follow(state: SlamState, frame: Frame, *, stages: Stages = untimed) -> Followed:
    """Find a frame's pose and bring the graph up to date; the map is left to whoever owns it.

    Arguments and errors as of `step`.
    """
    if frame.depth.shape != state.camera.shape or frame.rgb.shape != (*state.camera.shape, 3):
        raise ValueError(
            f"The frame has colour {frame.rgb.shape} and depth {frame.depth.shape}, the camera is for images "
            f"of {state.camera.shape}: pass frames of one size, and init() a state for each size."
        )
    number = state.num_frames
    with stages("tracking"):
        observation = observe(frame, state.camera, state.extractor, state.config.tracking)
        state = replace(state, num_frames=number + 1)
        state, tracking = _find(state, observation)
        state = _placed(state, tracking)
    info = _info(state, tracking)
    if not info.tracked:
        return Followed(replace(state, num_lost=state.num_lost + 1), info, None)

    with stages("graph"):
        could_be = _could_be_keyframe(tracking, observation)
        new_keyframe = True
        if not state.keyframes:
            state = _with_keyframe(state, observation, se3.identity(), number)
            _compile_ahead(state)
        elif tracking.found is not None and has_left(tracking.found, state.config) and could_be:
            state = _next_keyframe(state, observation, tracking, number)
        else:
            new_keyframe = False
        state, closed = _advance_graph(state, new_keyframe)
    log = state.log.with_frame(float(frame.timestamp), number, state.reference, state.T_reference_cam)
    view = None
    if _view_is_due(state, new_keyframe):
        view = view_of(frame, state.mapping_factor, state.reference, state.T_reference_cam, number)
    # What was no keyframe now may have to be one if the next frame has moved on too far.
    last = observation if could_be and not new_keyframe else None
    state = replace(state, log=log, last=last, last_view=state.last_view if view is None else number)
    info = info._replace(
        T_world_cam=state.T_world_cam,
        new_keyframe=new_keyframe,
        new_view=view is not None,
        loop_closed=closed,
    )
    return Followed(state, info, view)


def advance_map(
    state: SlamState, mapping: MapState, view: View | None, *, tracked: bool, stages: Stages = untimed
) -> tuple[MapState, float]:
    """What the map does after a frame: takes the keyframes' new poses and the view, and optimises.

    Returns:
        The map state, and its loss on the view last rendered, before the step on it (nan if none was).
    """
    config, loss = state.config.mapping, float("nan")
    if not tracked:
        return mapping, loss
    with stages("view"):
        mapping = follow_keyframes(mapping, state.keyframe_poses)
        if view is not None:
            mapping, loss = insert_view(mapping, view, state.mapping_camera, config)
    with stages("mapping"):
        extra = max(config.steps_per_view - 1, 0) if view is not None else 0
        for i in range(extra + config.steps_per_frame):
            share = 1.0 if i < extra else config.newest_share
            mapping, loss = optimise_once(
                mapping, state.mapping_camera, config, newest_share=share, seed=state.config.seed
            )
    return mapping, loss


def _compile_ahead(state: SlamState) -> None:
    """Run what later frames will need on the first one, so that none of them waits for a compiler.

    The first keyframe is tracked in itself, made a keyframe again, and the two are registered.
    """
    observation = state.keyframes[0].observation
    twin = _placed(state, track(state, observation))
    found = register(observation, observation, se3.identity(), state.camera, state.config.tracking)
    again = Tracking(0, found, Carrier.BOTH, False)
    _info(twin, again)
    search(twin, observation)
    has_left(found, state.config)
    twin = _next_keyframe(twin, observation, again, 1)
    twin = replace(twin, pending=((0, 1),))
    twin, _ = _advance_graph(twin, True)
    if twin.edges:
        believe(replace(twin, candidates=twin.edges[:1] * state.config.graph.loop_support))
    warm_up(twin.mapping, twin.keyframe_poses[:1], state.config.mapping)


def _find(state: SlamState, observation: Observation) -> tuple[SlamState, Tracking]:
    """Find a frame: in the reference, by way of the frame before, in any keyframe, or by searching.

    Returns:
        The state, in which the frame before is the newest keyframe if it was needed, and what was found.
    """
    if not state.keyframes:
        return state, _first(observation)
    tracking = track(state, observation)
    if tracking.carrier != Carrier.NONE:
        return state, tracking
    bridged = state
    if state.last is not None:
        bridged = _with_last_as_keyframe(state, state.last)
        by_last = track(bridged, observation)
        if by_last.carrier != Carrier.NONE:
            return bridged, by_last
    relocalised = relocalise(state, observation)
    if relocalised is not None:
        return state, relocalised
    searched = search(bridged, observation)
    return (state, tracking) if searched is None else (bridged, searched)


def _with_last_as_keyframe(state: SlamState, last: Observation) -> SlamState:
    """The state with the newest tracked frame as a keyframe."""
    target = state.keyframes[state.reference].observation
    found = register(last, target, state.T_reference_cam, state.camera, state.config.tracking)
    tracking = Tracking(state.reference, found, Carrier(int(found.carrier)), False)
    return _next_keyframe(state, last, tracking, state.log.newest)


def _placed(state: SlamState, tracking: Tracking) -> SlamState:
    """The state with the frame where it was found."""
    if tracking.carrier == Carrier.NONE or tracking.found is None:
        return replace(state, T_previous_current=se3.identity())
    T = tracking.found.T_target_source
    coasting, coasted = 0, 0.0
    if tracking.relocalised:
        motion = se3.identity()
    elif tracking.carrier == Carrier.COASTING:
        # Nothing new was learnt of it.
        motion = state.T_previous_current
        coasting, coasted = state.num_coasting + 1, state.coasted + extent(motion)
    else:
        motion = motion_since(state, tracking.reference, T)
    return replace(
        state,
        reference=tracking.reference,
        T_reference_cam=T,
        T_previous_current=motion,
        num_coasting=coasting,
        coasted=coasted,
    )


def _with_keyframe(
    state: SlamState, observation: Observation, T_world_cam: jaxlie.SE3, number: int
) -> SlamState:
    """The state with one more keyframe, which is the reference from now on."""
    slots = observation.keypoints.depth.shape[0]
    keyframe = Keyframe(observation, T_world_cam, np.full(slots, -1), number)
    return replace(
        state,
        keyframes=(*state.keyframes, keyframe),
        reference=len(state.keyframes),
        T_reference_cam=se3.identity(),
    )


def _next_keyframe(state: SlamState, observation: Observation, tracking: Tracking, number: int) -> SlamState:
    """The state with the frame as a keyframe, tied to its reference and waiting to be tied to others."""
    assert tracking.found is not None
    target, source = tracking.reference, len(state.keyframes)
    state = _with_keyframe(state, observation, state.T_world_cam, number)
    if not state.config.graph.enabled:
        return state
    state = share_landmarks(state, target, source, tracking.found)
    state = replace(state, edges=(*state.edges, edge_of(target, source, tracking.found, state.config.graph)))
    near = neighbours(state)
    far = tuple(pair for pair in loop_pairs(state) if pair not in near and pair[0] != target)
    return replace(state, pending=(*state.pending, *near, *far))


def _advance_graph(state: SlamState, new_keyframe: bool) -> tuple[SlamState, bool]:
    """Register a pair or so of keyframes; once the newest has no more to wait for, optimise.

    Returns:
        The state, and whether a loop was closed.
    """
    config, closed = state.config.graph, False
    if not config.enabled:
        return state, False
    waited = bool(state.pending)
    # A backlog is worked off faster: a keyframe brings some ten pairs, and the next may come soon.
    for _ in range(max(config.registrations_per_frame, len(state.pending) // _BACKLOG)):
        if not state.pending:
            break
        (target, source), rest = state.pending[0], state.pending[1:]
        found, correction = register_pair(state, target, source)
        state = replace(state, pending=rest)
        if is_edge(state, found, correction):
            state = share_landmarks(state, target, source, found)
            state = replace(state, edges=(*state.edges, edge_of(target, source, found, config)))
        elif is_candidate(state, target, source, found):
            state, closed_now = believe(with_candidate(state, edge_of(target, source, found, config)))
            closed |= closed_now
    if closed or (not state.pending and (waited or new_keyframe)):
        state = optimise_window(optimise_poses(state))
    return state, closed


def _could_be_keyframe(tracking: Tracking, observation: Observation) -> bool:
    # A pose that rests on the motion model in part would pass its error on to all that follow.
    firm = tracking.carrier != Carrier.COASTING and not tracking.relocalised
    return firm and _shows_something(observation)


def _view_is_due(state: SlamState, new_keyframe: bool) -> bool:
    since, interval = state.num_frames - 1 - state.last_view, state.config.mapping.view_interval
    if not new_keyframe or len(state.keyframes) == 1:
        return new_keyframe or since >= interval
    # A keyframe shows something new, unless between it and the one before there was a view just now.
    between = state.last_view > state.keyframes[-2].frame
    return not between or 2 * since >= interval


def _shows_something(observation: Observation) -> bool:
    """Whether a frame could be registered to this one."""
    keypoints = observation.keypoints
    # In NumPy, which looks at memory where it lies: this is asked of every frame.
    measured = np.asarray(keypoints.features.valid) & (np.asarray(keypoints.depth) > 0)
    return bool(np.asarray(observation.cloud.levels[0].valid).any() or measured.any())


def _info(state: SlamState, tracking: Tracking) -> StepInfo:
    """What is known once a frame has been tracked."""
    found = tracking.found
    return StepInfo(
        T_world_cam=state.T_world_cam,
        tracked=tracking.carrier != Carrier.NONE,
        carrier=tracking.carrier,
        relocalised=tracking.relocalised,
        new_keyframe=False,
        new_view=False,
        loop_closed=False,
        inlier_fraction=0.0 if found is None else float(found.inlier_fraction),
        rmse=0.0 if found is None else float(found.rmse),
        num_matches=0 if found is None else int(found.matched.num_matches),
        num_inliers=0 if found is None else int(found.matched.num_inliers),
        loss=float("nan"),
    )


def _first(observation: Observation) -> Tracking:
    """The first frame is where the world begins, unless nothing could be registered to it."""
    return Tracking(0, None, Carrier.BOTH if _shows_something(observation) else Carrier.NONE, False)


_BACKLOG = 10
"""Waiting registrations beyond which more than one is done at a time."""
