"""Warm-up: compile the programs of a run before the first frame waits for them."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, Frame, se3
from sfgs_jax.slam._init import init
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.frontend import (
    Localised,
    as_reference,
    begin_tracking,
    features_in_use,
    find_frame,
    needs_keyframe,
    place,
    register,
    search_by_surface,
    with_depth_parameters,
)
from sfgs_jax.slam.keyframes import (
    NewKeyframe,
    accept_consistent_loops,
    advance_graph,
    bend,
    first_keyframe,
    focal_lengths_by,
    insert_keyframe,
    rectified_anew,
    return_to_keyframe,
    with_adjustment_taken,
)
from sfgs_jax.slam.mapping import map_frame, prune, refine_once, view_of
from sfgs_jax.slam.state import Registration, SlamState, mapping_factor, move, reference_at, with_graph_poses
from sfgs_jax.slam.step import follow

_DEPTH = 2.0
"""Depth of the made-up frames, metres."""
_ANOTHER_OFFSET = 1e-4
"""Change of the made-up correction of depth, 1/m."""


@checked
def warm_up(camera: Camera, config: SlamConfig | None = None) -> None:
    """Compile the programs of a run, those of lost frames, loops and pruning among them.

    A made-up frame is tracked. The programs of the graph, of the search for lost frames and of the map
    compile beside it. They are called with the empty reference of a new tracker, for only shapes count.
    Another call for the same image size and settings takes as long as a few frames.

    Args:
        camera: intrinsics of the frames.
        config: settings.
    """
    state = init(camera, config)
    rgb = np.random.default_rng(0).random((*camera.shape, 3), np.float32)
    frame, empty = Frame(rgb, np.full(camera.shape, _DEPTH, np.float32), 0.0), _with_empty_keyframe(state)
    with ThreadPoolExecutor(thread_name_prefix="sfgs_jax warm-up") as threads:
        # Two threads that need one program at once would both compile it.
        registered = threads.submit(_registered, empty)
        beside = [
            threads.submit(_compile_graph, empty, registered),
            threads.submit(_compile_lost, empty, registered),
            threads.submit(_compile_map, empty, frame),
        ]
        _compile_tracking(state, frame, registered)
    for part in beside:
        part.result()


def _with_empty_keyframe(state: SlamState) -> SlamState:
    """The state with a keyframe that shows nothing."""
    features, twist = reference_at(state.tracker, np.asarray(0, np.int32)).features, np.ones(6, np.float32)
    new = NewKeyframe(features, twist, np.zeros(3, np.float32), 0)
    graph = first_keyframe(state.params, state.graph, new, se3.identity(), state.config.graph)
    return replace(state, graph=graph)


def _registered(state: SlamState) -> Registration:
    """The registration of a keyframe to itself."""
    features = state.graph.keyframes[0].features
    return register(state.params, features, features, se3.identity())


def _compile_tracking(state: SlamState, frame: Frame, registered: Future[Registration]) -> None:
    """A frame and what follows from it, and the return to a keyframe from before."""
    for seconds in (0.0, 1.0):
        state, _, _ = follow(state, replace(frame, timestamp=seconds))
    graph, config = state.graph, state.config
    tracked = begin_tracking(state.params, state.tracker, frame, 1.0)
    found = find_frame(state.params, state.tracker, tracked, frame, 1.0, graph, config.graph)
    again = registered.result()
    needs_keyframe(again, config.tracking)
    return_to_keyframe(found.tracker, found.info, as_reference(state.params, graph, 0), again)


def _compile_map(state: SlamState, frame: Frame) -> None:
    """A view in the map, the map's motion with its keyframes, and its refinement."""
    config, camera = state.config.mapping, state.mapping_camera
    factor = mapping_factor(state.camera, config)
    view = view_of(frame, factor, 0, se3.identity(), 0, np.zeros(6, np.float32))
    mapping, _ = map_frame(state.mapping, state, view)
    refine_once(mapping, camera, config, number=0, done=0.0, seed=0)
    move(mapping.map, state.graph.poses, state.graph.poses)
    jax.block_until_ready(prune(mapping.map, config.prune_opacity))


def _compile_graph(state: SlamState, registered: Future[Registration]) -> None:
    """Insertion of a keyframe, its registration, adjustment, loop closure, another correction of depth."""
    config, found = state.config.graph, registered.result()
    keyframe, times = state.graph.keyframes[0], np.zeros(3, np.float32)
    new = NewKeyframe(keyframe.features, keyframe.twist, times, 1)
    graph = insert_keyframe(state.params, state.graph, new, found, 0, config)
    if state.config.tracking.features.kind != "none":
        focal_lengths_by(state.params, keyframe.features, keyframe.features, found)
    graph, _ = advance_graph(state.params, replace(graph, pending=((0, 1),)), config, grown=True)
    graph = with_adjustment_taken(graph)
    if graph.edges:
        bend(graph, config)
        candidates = graph.edges[:1] * config.loop_support
        accept_consistent_loops(replace(graph, candidates=candidates), config)
    tracker = with_graph_poses(state.tracker, graph)
    if state.config.tracking.estimate_depth:
        known = graph.depth_parameters + _ANOTHER_OFFSET, graph.depth_covariance
        params, _ = with_depth_parameters(state.params, tracker, *known)
        features_in_use(params, graph.keyframes[0])
    if state.config.tracking.estimate_timing:
        rectified_anew(state.params, graph, times + 1, config)


def _compile_lost(state: SlamState, registered: Future[Registration]) -> None:
    """Search by the surface, and what follows when a frame is found again."""
    features = state.graph.keyframes[0].features
    # Around the frame before, and around the reference where that frame is the reference.
    for has_last in (True, False):
        tracker = eqx.tree_at(lambda t: t.has_last, state.tracker, jnp.asarray(has_last))
        search_by_surface(state.params, tracker, features)
    reference = as_reference(state.params, state.graph, 0)
    localised = Localised(reference, registered.result(), bridged=False, relocalised=True)
    place(state.params, state.tracker, features, localised)
