"""The graph's work after a frame: a few registrations, and once none is left, its optimisation."""

from dataclasses import replace

import jaxlie
import numpy as np

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import features_in_use
from sfgs_jax.slam.frontend._joint_registration import register
from sfgs_jax.slam.frontend._pose_source import supports_edge, supports_loop
from sfgs_jax.slam.keyframes._adjustment import has_landmarks
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_begun, with_frame_passed
from sfgs_jax.slam.keyframes._depth_estimate import with_new_depth_parameters, with_registration
from sfgs_jax.slam.keyframes._edge_noise import edge_noise
from sfgs_jax.slam.keyframes._landmarks import share_landmarks
from sfgs_jax.slam.keyframes._loops import accept_consistent_loops, likely_drift, with_candidate
from sfgs_jax.slam.keyframes._merging import with_bridge_tried
from sfgs_jax.slam.keyframes._pose_graph import compile_ahead, is_contradicted, optimise_poses
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._maps import maps_of
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import TrackerParams


def advance_graph(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, *, grown: bool
) -> tuple[KeyframeGraph, bool]:
    """Register a pair or so of keyframes. Once no new pair waits, and once none does, optimise.

    Optimising is put off while an adjustment is under way.

    Args:
        params: parameters of tracking.
        graph: before.
        config: settings.
        grown: whether a keyframe was inserted for this frame.

    Returns:
        The graph, and whether a loop was closed.
    """
    if not config.enabled:
        return graph, False
    graph = with_frame_passed(graph)
    compile_ahead(graph, config)
    closed, waited, waited_again = False, bool(graph.pending), bool(graph.again)
    # A keyframe brings some ten pairs, and the next may come soon: a backlog is worked off faster.
    for _ in range(
        max(config.registrations_per_frame, (len(graph.pending) + len(graph.again)) // config.backlog)
    ):
        if not (graph.pending or graph.again):
            break
        graph, closed_now = _register_next(params, graph, config)
        closed |= closed_now
    done = not graph.pending and (waited or grown or (waited_again and not graph.again))
    overdue = not (graph.pending or graph.again) and graph.num_absorbed < len(graph.edges)
    # One that is under way is not waited for: the next begins after it.
    if (closed or done or overdue) and graph.adjustment is None:
        graph = with_new_depth_parameters(params, graph)
        graph = _optimised(params, replace(graph, noise=edge_noise(params, graph, config)), config)
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


def _register_next(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig
) -> tuple[KeyframeGraph, bool]:
    """The graph after the next waiting pair was registered, and whether that closed a loop."""
    name = "pending" if graph.pending else "again"
    (target, source), *rest = getattr(graph, name)
    graph = replace(graph, **{name: tuple(rest)})
    a, b = (features_in_use(params, graph.keyframes[number]) for number in (target, source))
    maps = maps_of(graph)
    if maps[target] != maps[source]:
        return with_bridge_tried(params, graph, target, source, (a, b), config)
    found, off = register_pair(params, graph, target, source, (a, b))
    correction = float(max(np.linalg.norm(off[:3]), np.linalg.norm(off[3:])))
    with_keypoints = params.config.features.kind != "none"
    if supports_edge(found, correction, config, with_keypoints=with_keypoints):
        graph = share_landmarks(graph, target, source, found)
        told, graph = _without_edge(graph, target, source)
        graph, edge = with_registration(params, graph, target, source, (a, b), found, config, told=not told)
        edge = replace(edge, told=edge.told or told)
        return replace(graph, edges=(*graph.edges, edge)), False
    may_be_loop = config.loops and source - target > config.loop_gap
    if may_be_loop and supports_loop(found, off, likely_drift(graph, target, source, config), config):
        graph, candidate = with_registration(params, graph, target, source, (a, b), found, config, told=False)
        return accept_consistent_loops(with_candidate(graph, candidate, config), config)
    return graph, False


def _without_edge(graph: KeyframeGraph, target: int, source: int) -> tuple[bool, KeyframeGraph]:
    """Whether the estimate of depth has heard a pair before, and the graph without its edge from then."""
    kept = [(edge.target, edge.source) != (target, source) for edge in graph.edges]
    if all(kept):
        return False, graph
    told = any(edge.told for edge, keep in zip(graph.edges, kept, strict=True) if not keep)
    edges = tuple(edge for edge, keep in zip(graph.edges, kept, strict=True) if keep)
    return told, replace(graph, edges=edges, num_absorbed=sum(kept[: graph.num_absorbed]))


def register_pair(
    params: TrackerParams,
    graph: KeyframeGraph,
    target: int,
    source: int,
    features: tuple[FrameFeatures, FrameFeatures],
) -> tuple[Registration, np.ndarray]:
    """Register a keyframe to another from where the graph has them.

    Args:
        params: parameters of tracking.
        graph: that holds them.
        target: number of the keyframe to register to.
        source: number of the keyframe to register.
        features: of both, target and source, with the correction of depth of `params`.

    Returns:
        The registration, and the (6,) tangent of its disagreement with the graph.
    """
    guess = se3.compose(se3.inverse(graph.pose(target)), graph.pose(source))
    found = register(params, features[1], features[0], jaxlie.SE3(guess.wxyz_xyz))
    return found, np.asarray(se3.log(se3.compose(se3.inverse(guess), found.T_target_source)))
