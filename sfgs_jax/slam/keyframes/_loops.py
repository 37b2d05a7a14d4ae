"""Loop closure: candidates by image similarity, verification by registration, pairwise consistency."""

from collections.abc import Sequence
from dataclasses import replace

import jaxlie
import numpy as np

from sfgs_jax.factor_graph import Values, consistent_loops
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import most_similar
from sfgs_jax.slam.keyframes._edges import relative_poses
from sfgs_jax.slam.keyframes._pose_graph import padded_poses, pose_capacity
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._maps import maps_of

_DEVIATIONS = 5.0
"""Standard deviations that a drift hardly exceeds, though errors of registrations have long tails."""


def loop_pairs(graph: KeyframeGraph, config: GraphConfig) -> tuple[tuple[int, int], ...]:
    """Pairs (target, source) of the newest keyframe with earlier ones, or of other maps, that look like it.

    Args:
        graph: with at least one keyframe.
        config: settings.
    """
    newest, maps = len(graph.keyframes) - 1, maps_of(graph)
    far = (np.arange(newest) < newest - config.loop_gap) | (maps[:newest] != maps[newest])
    if not config.loops or not far.any():
        return ()
    known, signature = graph.signatures[:newest], graph.signatures[newest]
    alike, cosines = most_similar(known, signature, config.loop_candidates, among=far)
    return tuple((int(i), newest) for i in alike[cosines > config.loop_similarity])


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
    # Nothing is known about the way from one map to another.
    same = np.diff(maps_of(graph)[start : end + 1]) == 0
    travelled = np.linalg.norm(steps[same], axis=1).sum()
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
    maps = maps_of(graph)
    candidates = [c for c in graph.candidates if maps[c.target] == maps[c.source]]
    closed = agreeing(graph, candidates, config, least=config.loop_support)
    if not closed:
        return graph, False
    others = tuple(c for c in graph.candidates if maps[c.target] != maps[c.source])
    return replace(graph, edges=(*graph.edges, *closed), candidates=others), True


def agreeing(
    graph: KeyframeGraph, candidates: Sequence[Edge], config: GraphConfig, *, least: int
) -> tuple[Edge, ...]:
    """The candidates that agree with each other, as loops; none where there are too few.

    Args:
        graph: with their keyframes.
        candidates: at most `max_loop_candidates`.
        config: settings.
        least: number that has to agree.
    """
    if len(candidates) < least:
        return ()
    poses = padded_poses(graph.poses, pose_capacity(graph, config))
    # Each is judged by its own deviations.
    noise = replace(graph.noise, redundancy=1.0)
    agreed = consistent_loops(
        relative_poses(
            candidates, config.max_loop_candidates, noise=noise, depth_parameters=graph.depth_parameters
        ),
        Values(jaxlie.SE3(poses)),
    )
    if agreed.sum() < least:
        return ()
    return tuple(replace(edge, loop=True) for edge, good in zip(candidates, agreed, strict=False) if good)
