"""Warm-up: compile the programs of a run before the first frame waits for them."""

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
    features_in_use,
    find_frame,
    needs_keyframe,
    place,
    register,
    search_by_surface,
    with_depth_parameters,
)
from sfgs_jax.slam.keyframes import (
    Reference,
    accept_consistent_loops,
    advance_graph,
    bend,
    insert_keyframe,
    rectified_anew,
    return_to_keyframe,
    with_adjustment_taken,
)
from sfgs_jax.slam.mapping import prune, refine_once
from sfgs_jax.slam.state import SlamState, move, reference_at, with_graph_poses
from sfgs_jax.slam.step import step

_DEPTH = 2.0
"""Depth of the made-up frames, metres."""
_ANOTHER_OFFSET = 1e-4
"""Change of the made-up correction of depth, 1/m."""


@checked
def warm_up(camera: Camera, config: SlamConfig | None = None) -> None:
    """Compile the programs of a run, those of lost frames, loops and pruning among them.

    Two made-up frames run through the steps. Another call for the same image size and settings takes as long
    as a few frames.

    Args:
        camera: intrinsics of the frames.
        config: settings.
    """
    state = init(camera, config)
    rgb = np.random.default_rng(0).random((*camera.shape, 3), np.float32)
    frame = Frame(rgb, np.full(camera.shape, _DEPTH, np.float32), 0.0)
    for seconds in (0.0, 1.0):
        state, _ = step(state, replace(frame, timestamp=seconds))
    _compile_graph(state)
    _compile_return(state, frame)
    _compile_lost(state)
    refine_once(state.mapping, state.mapping_camera, state.config.mapping, number=0, done=0.0, seed=0)
    move(state.mapping.map, state.graph.poses[:1], state.graph.poses[:1])
    jax.block_until_ready(prune(state.mapping.map, state.config.mapping.prune_opacity))


def _compile_graph(state: SlamState) -> None:
    """Insertion of a keyframe, its registration, adjustment, loop closure, another correction of depth."""
    config = state.config.graph
    features, twist = state.graph.keyframes[0].features, np.ones(6, np.float32)
    times = np.zeros(3, np.float32)
    found = register(state.params, features, features, se3.identity())
    graph = insert_keyframe(state.params, state.graph, Reference(features, twist, times, 1), found, 0, config)
    graph, _ = advance_graph(state.params, replace(graph, pending=((0, 1),)), config, grown=True)
    graph = with_adjustment_taken(graph)
    if graph.edges:
        bend(graph, config)
        candidates = graph.edges[:1] * config.loop_support
        accept_consistent_loops(replace(graph, candidates=candidates), config)
    tracker = with_graph_poses(state.tracker, graph)
    if state.config.tracking.estimate_depth:
        params, _ = with_depth_parameters(state.params, tracker, graph.depth_parameters + _ANOTHER_OFFSET)
        features_in_use(params, graph.keyframes[0])
    if state.config.tracking.estimate_timing:
        rectified_anew(state.params, graph, times + 1, config)


def _compile_lost(state: SlamState) -> None:
    """Search by the surface, and what follows when a frame is found again."""
    features, pose = state.graph.keyframes[0].features, state.graph.poses[0]
    # Around the frame before, and around the reference where that frame is the reference.
    for has_last in (True, False):
        tracker = eqx.tree_at(lambda t: t.has_last, state.tracker, jnp.asarray(has_last))
        search_by_surface(state.params, tracker, features)
    found = register(state.params, features, features, se3.identity())
    place(state.params, state.tracker, features, Localised(0, features, pose, found, False, True))


def _compile_return(state: SlamState, frame: Frame) -> None:
    """The return to a keyframe from before."""
    graph = state.graph
    found = find_frame(state.params, state.tracker, frame, 1.0, graph, state.config.graph)
    tracker, info = found.tracker, found.info
    new, features = reference_at(tracker, tracker.current), graph.keyframes[0].features
    again = register(state.params, new, features, se3.identity())
    needs_keyframe(again, state.config.tracking)
    return_to_keyframe(tracker, info, features, graph.poses[0], np.asarray(0, np.int32), again)
