"""The graph's work after a frame: a few registrations, and its optimisation after those of a keyframe."""

from dataclasses import replace

import numpy as np

from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend._pose_source import supports_edge, supports_loop
from sfgs_jax.slam.keyframes._adjustment import has_landmarks
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_begun, with_frame_passed
from sfgs_jax.slam.keyframes._depth_drift import with_drift_since
from sfgs_jax.slam.keyframes._depth_estimate import with_edge_heard, with_new_depth_parameters
from sfgs_jax.slam.keyframes._edge_noise import edge_noise
from sfgs_jax.slam.keyframes._landmarks import share_landmarks
from sfgs_jax.slam.keyframes._loops import accept_consistent_loops, likely_drift, with_candidate
from sfgs_jax.slam.keyframes._merging import with_bridge_tried
from sfgs_jax.slam.keyframes._pair_registration import RegisteredPair, disagreement, registered_pairs
from sfgs_jax.slam.keyframes._pose_graph import compile_ahead, is_contradicted, optimise_poses
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_MANY_NEW = 10
"""New edges after which an optimisation waits for no more: a keyframe brings about as many."""


def advance_graph(
    params: TrackerParams,
    graph: KeyframeGraph,
    config: GraphConfig,
    *,
    grown: bool,
    registered: tuple[RegisteredPair, ...] | None = None,
) -> tuple[KeyframeGraph, bool]:
    """Take a few registrations of keyframes. Once no new pair waits, and once none does, optimise.

    Many new edges are enough, for some pair always waits if keyframes come fast. Optimising is put off while
    an adjustment is under way.

    Args:
        params: parameters of tracking.
        graph: before.
        config: settings.
        grown: whether a keyframe was inserted for this frame.
        registered: pairs that were registered meanwhile; if not given, those whose turn it is are registered
            now.

    Returns:
        The graph, and whether a loop was closed.
    """
    if not config.enabled:
        return graph, False
    graph = with_frame_passed(graph)
    compile_ahead(graph, config)
    closed, waited, waited_again = False, bool(graph.pending), bool(graph.again)
    for pair in registered_pairs(params, graph, config) if registered is None else registered:
        # One that does not hold any more keeps its place.
        if pair.holds(graph):
            if pair.by_tracking:
                graph = _with_heard(graph, pair, config)
                continue
            graph, closed_now = _with_registered(_without_waiting(graph, pair), pair, config)
            closed |= closed_now
    done = not graph.pending and (waited or grown or (waited_again and not graph.again))
    new, waits = len(graph.edges) - graph.num_absorbed, bool(graph.pending or graph.again)
    overdue = new >= _MANY_NEW or (new > 0 and not waits)
    # One that is under way is not waited for: the next begins after it.
    if (closed or done or overdue) and graph.adjustment is None:
        graph = with_new_depth_parameters(params, graph)
        graph = _optimised(params, replace(graph, noise=edge_noise(graph, config)), config)
    return graph, closed


def _optimised(params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> KeyframeGraph:
    """The graph with its keyframes where registrations and landmarks want them.

    With landmarks an adjustment of the newest keyframes is only begun. All others are to move too where a
    place is seen again elsewhere than where the graph has it.
    """
    if not has_landmarks(params, config):
        return replace(optimise_poses(graph, config), num_absorbed=len(graph.edges))
    new = graph.edges[graph.num_absorbed :]
    off = len(graph.keyframes) > config.window and is_contradicted(graph)
    graph = with_adjustment_begun(params, graph, config, bent=off or any(edge.loop for edge in new))
    return replace(graph, num_absorbed=len(graph.edges))


def _with_heard(graph: KeyframeGraph, pair: RegisteredPair, config: GraphConfig) -> KeyframeGraph:
    """The graph after the estimates of the camera have heard the edge that a keyframe was tracked by."""
    ends = pair.target, pair.source
    graph, edge = with_edge_heard(graph, pair, config)
    graph = replace(
        graph,
        edges=tuple(edge if (e.target, e.source) == ends else e for e in graph.edges),
        tracked=tuple(p for p in graph.tracked if (p.target, p.source) != ends),
    )
    return with_drift_since(graph, pair.source)


def _without_waiting(graph: KeyframeGraph, pair: RegisteredPair) -> KeyframeGraph:
    """The graph in which a pair does not wait any more."""
    ends = pair.target, pair.source
    name = "pending" if ends in graph.pending else "again"
    return replace(graph, **{name: tuple(other for other in getattr(graph, name) if other != ends)})


def _with_registered(
    graph: KeyframeGraph, pair: RegisteredPair, config: GraphConfig
) -> tuple[KeyframeGraph, bool]:
    """The graph with what the registration of a pair says, and whether that closed a loop."""
    if pair.are_apart:
        return with_bridge_tried(graph, pair, config)
    found, target, source = pair.found, pair.target, pair.source
    off = disagreement(graph, pair)
    correction = float(max(np.linalg.norm(off[:3]), np.linalg.norm(off[3:])))
    with_keypoints = pair.params.config.features.kind != "none"
    if supports_edge(found, correction, config, with_keypoints=with_keypoints):
        graph = share_landmarks(graph, target, source, found)
        told, graph = _without_edge(graph, target, source)
        if told:
            edge = replace(pair.edge, told=True)
        else:
            graph, edge = with_edge_heard(graph, pair, config)
        return replace(graph, edges=(*graph.edges, edge)), False
    may_be_loop = config.loops and source - target > config.loop_gap
    if may_be_loop and supports_loop(found, off, likely_drift(graph, target, source, config), config):
        return accept_consistent_loops(with_candidate(graph, pair.edge, config), config)
    return graph, False


def _without_edge(graph: KeyframeGraph, target: int, source: int) -> tuple[bool, KeyframeGraph]:
    """Whether the estimate of depth has heard a pair before, and the graph without its edge from then."""
    kept = [(edge.target, edge.source) != (target, source) for edge in graph.edges]
    if all(kept):
        return False, graph
    told = any(edge.told for edge, keep in zip(graph.edges, kept, strict=True) if not keep)
    edges = tuple(edge for edge, keep in zip(graph.edges, kept, strict=True) if keep)
    return told, replace(graph, edges=edges, num_absorbed=sum(kept[: graph.num_absorbed]))
