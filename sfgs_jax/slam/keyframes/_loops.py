"""Loop closure: candidates by image similarity, verification by registration, pairwise consistency."""

from dataclasses import replace

import jaxlie
import numpy as np

from sfgs_jax.factor_graph import Values, consistent_loops
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend._localisation import keyframe_similarities
from sfgs_jax.slam.keyframes._edges import relative_poses
from sfgs_jax.slam.keyframes._pose_graph import padded_poses, pose_capacity
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph

_DEVIATIONS = 5.0
"""Standard deviations that a drift hardly exceeds, though errors of registrations have long tails."""


def loop_pairs(graph: KeyframeGraph, config: GraphConfig) -> tuple[tuple[int, int], ...]:
    """Pairs (target, source) of the newest keyframe with earlier ones that look like it.

    Args:
        graph: with at least one keyframe.
        config: settings.
    """
    newest = len(graph.keyframes) - 1
    old = newest - config.loop_gap
    if not config.loops or old < 1:
        return ()
    alike = keyframe_similarities(graph.keyframes, graph.keyframes[newest].features)[:old]
    order = np.argsort(-alike, kind="stable")[: config.loop_candidates]
    return tuple((int(i), newest) for i in order if alike[i] > config.loop_similarity)


def likely_drift(graph: KeyframeGraph, start: int, end: int, config: GraphConfig) -> float:
    """Largest drift that is likely between two keyframes, metres.

    It is so many deviations of their positions, but no more than a share of the path between them.

    Args:
        graph: that holds them.
        start: number of the earlier keyframe.
        end: number of the later keyframe.
        config: settings.
    """
    steps = np.diff(graph.poses[start : end + 1, 4:], axis=0)
    travelled = np.linalg.norm(steps, axis=1).sum()
    variances = np.trace(graph.covariances[[start, end], :3, :3], axis1=1, axis2=2)
    return float(min(config.max_drift * travelled, _DEVIATIONS * np.sqrt(variances).sum()))


def with_candidate(graph: KeyframeGraph, candidate: Edge, config: GraphConfig) -> KeyframeGraph:
    """The graph with one more candidate loop; the oldest beyond the capacity are dropped.

    Args:
        graph: before.
        candidate: to be accepted once others agree with it.
        config: settings.
    """
    return replace(graph, candidates=(*graph.candidates, candidate)[-config.max_loop_candidates :])


def accept_consistent_loops(graph: KeyframeGraph, config: GraphConfig) -> tuple[KeyframeGraph, bool]:
    """Turn the candidates that agree with each other into edges, if there are enough of them.

    Args:
        graph: with candidates.
        config: settings.

    Returns:
        The graph, and whether a loop was closed.
    """
    candidates = graph.candidates
    if len(candidates) < config.loop_support:
        return graph, False
    poses = padded_poses(graph.poses, pose_capacity(graph, config))
    # Each is judged by its own deviations.
    noise = replace(graph.noise, redundancy=1.0)
    agreed = consistent_loops(
        relative_poses(candidates, config.max_loop_candidates, noise=noise, offsets=graph.offsets),
        Values(jaxlie.SE3(poses)),
    )
    if agreed.sum() < config.loop_support:
        return graph, False
    pairs = zip(candidates, agreed[: len(candidates)], strict=True)
    closed = tuple(replace(edge, loop=True) for edge, good in pairs if good)
    return replace(graph, edges=(*graph.edges, *closed), candidates=()), True
