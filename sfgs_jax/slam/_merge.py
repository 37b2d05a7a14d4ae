"""Map merging: the runs of two recordings by the same camera, in one world and with one map."""

from dataclasses import replace

import equinox as eqx
import jax
import numpy as np

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import same_camera
from sfgs_jax.sensors import FrameClock
from sfgs_jax.slam._graph_results import finish, with_graph
from sfgs_jax.slam._new_session import lost, same_but_refinement
from sfgs_jax.slam.frontend import depth_parameters_in_use, estimated_timing, timing_prior
from sfgs_jax.slam.keyframes import (
    advance_graph,
    joined_graphs,
    pairs_that_look_alike,
    pairs_that_see_the_same,
    tied,
    with_adjustment_taken,
)
from sfgs_jax.slam.mapping import follow_keyframes, follow_trajectory, joined_views, with_lacking_gaussians
from sfgs_jax.slam.state import FrameLog, SlamState, shift_of_numbers, trajectory_of


@checked
def merge(a: SlamState, b: SlamState) -> SlamState:
    """The state of two runs in the world of the first, once places of the second are recognised in it.

    The keyframes of b become another map of a. The pairs of keyframes whose images look most alike are
    registered, until `map_support` registrations agree on where that map lies. Then keyframes of both that
    see the same are registered, and the graph is adjusted as at the end of a run. Source: the merging of maps
    in ORB-SLAM3 (Campos et al., 2021), section VI.

    The Gaussians follow their keyframes. If the map of a has a surface already, Gaussians of b on it are left
    out. The others get the exposure of a, by the surface that both maps show. The map is not refined, which
    `refine` does. Estimates of the camera's depth and of the times of its rows rest on both runs.

    The frames of b come after those of a, with their own time stamps. `state.rows_by_recording` tells the
    recordings apart. Another recording goes on in the result by `new_session`, and a third run may be merged
    with it.

    Args:
        a: after the last frame of a recording; the world is its own.
        b: after the last frame of another recording in the same place.

    Raises:
        InputError: a state has no keyframes, cameras or settings differ, loops are switched off, one run
            began in the map of the other, or no place of b was recognised in a.
    """
    _check(a, b)
    a, b = _settled(a), _settled(b)
    first = len(a.graph.keyframes)
    state = _recognised(_joined(a, b), first)
    state = finish(_with_neighbours(state, first))
    mapping = follow_trajectory(state.mapping, state.log, trajectory_of(state.log, state.graph))
    mapping = with_lacking_gaussians(mapping, b.mapping, state.mapping_camera, state.config.mapping)
    tracker = lost(state.tracker, len(state.graph.keyframes))
    return replace(state, mapping=mapping, tracker=tracker)


def _check(a: SlamState, b: SlamState) -> None:
    for state, name in ((a, "first"), (b, "second")):
        if not state.graph.keyframes:
            raise InputError(f"The {name} run has no keyframes, so that there is no map to merge.")
    if not same_camera(a.camera, b.camera):
        raise InputError("The runs were made with different cameras; only runs of one camera can be merged.")
    if not same_but_refinement(a.config, b.config):
        raise InputError("The runs were made with different settings; only runs with the same can be merged.")
    if not (a.config.graph.enabled and a.config.graph.loops):
        raise InputError("The runs were made without loops, and only loops can tie their maps to each other.")
    both = min(len(a.graph.signatures), len(b.graph.signatures))
    if np.array_equal(a.graph.signatures[:both], b.graph.signatures[:both]):
        raise InputError(
            "Both runs begin with the same keyframes: one is the other, or of the same images, or began in "
            "its map. So both are in one world already."
        )


def _settled(state: SlamState) -> SlamState:
    """The state without an adjustment under way, and its whole map where the keyframes are."""
    state = with_graph(state, with_adjustment_taken(state.graph))
    mapping = follow_keyframes(state.mapping, state.graph.poses, state.row_times)
    return replace(state, mapping=replace(mapping, map=mapping.whole, submaps=()))


def _joined(a: SlamState, b: SlamState) -> SlamState:
    """The state of a with the keyframes, views and frames of b in another map, without the Gaussians of b."""
    first = len(a.graph.keyframes)
    shift = shift_of_numbers(a.next_frame - 1, min(keyframe.frame for keyframe in b.graph.keyframes))
    graph = joined_graphs(a.graph, b.graph, shift)
    tracker = a.tracker
    if a.config.tracking.estimate_timing:
        (times, depth), (others, their_depth) = (
            (p.timing.on_host(), depth_parameters_in_use(p)) for p in (a.params, b.params)
        )
        ahead = np.concatenate([times - others, depth - their_depth])
        told = tracker.timing.joined(b.tracker.timing.counted_from(ahead), timing_prior(a.params))
        tracker = eqx.tree_at(lambda t: t.timing, tracker, told)
        times, covariance = estimated_timing(a.params, tracker)
        tracker = eqx.tree_at(lambda t: t.last_motion.timing, tracker, times)
        graph = replace(graph, times_covariance=np.asarray(covariance, np.float64))
    return replace(
        a,
        tracker=tracker,
        graph=graph,
        mapping=joined_views(a.mapping, b.mapping, shift),
        log=_joined_logs(a.log, b.log, first, shift),
        next_frame=b.next_frame + shift,
        clock=FrameClock(),
        last_view=b.last_view + shift,
        last_look=b.last_look,
        num_lost=a.num_lost + b.num_lost,
    )


def _joined_logs(a: FrameLog, b: FrameLog, first: int, shift: int) -> FrameLog:
    b = replace(b, keyframes=b.keyframes + first, numbers=b.numbers + shift)
    return jax.tree.map(lambda *parts: np.concatenate(parts), a, b)


def _recognised(state: SlamState, first: int) -> SlamState:
    """The state once the graph has tied the keyframes from the first one on to those before.

    Raises:
        InputError: too few registrations agree.
    """
    config = state.config.graph
    pairs = pairs_that_look_alike(state.graph, first, config, most=config.num_neighbours)
    state = replace(state, graph=replace(state.graph, pending=(*state.graph.pending, *pairs)))
    while not tied(state.graph, first):
        if not state.graph.pending:
            raise InputError(
                "No place of the second run was recognised in the map of the first: fewer than "
                f"{config.map_support} registrations of their keyframes agree (map_support)."
            )
        graph, _ = advance_graph(state.params, state.graph, config, grown=False)
        state = with_graph(state, graph)
    return with_graph(state, with_adjustment_taken(state.graph))


def _with_neighbours(state: SlamState, first: int) -> SlamState:
    """The state with the pairs of keyframes that are left to register now that all are in one world."""
    graph, config = state.graph, state.config.graph
    near = pairs_that_see_the_same(graph, first, config)
    # A place far from where the recordings were tied may be off by more than neighbours are apart.
    alike = pairs_that_look_alike(graph, first, config, most=config.loop_candidates)
    loops = tuple(pair for pair in graph.pending if pair in alike and pair not in near)
    return replace(state, graph=replace(graph, pending=near + loops))
