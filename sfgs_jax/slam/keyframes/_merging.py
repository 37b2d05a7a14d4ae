"""Two maps become one where loops between them agree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import confirms_loop
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_taken
from sfgs_jax.slam.keyframes._depth_drift import drift_of_followers
from sfgs_jax.slam.keyframes._edges import motions_of
from sfgs_jax.slam.keyframes._loops import agreeing, with_candidate
from sfgs_jax.slam.keyframes._pair_registration import RegisteredPair
from sfgs_jax.slam.state._keyframe_graph import Edge, KeyframeGraph
from sfgs_jax.slam.state._maps import maps_of


def with_bridge_tried(
    graph: KeyframeGraph, pair: RegisteredPair, config: GraphConfig
) -> tuple[KeyframeGraph, bool]:
    """The graph after keyframes of two maps were registered, and whether the maps became one by that.

    Rooms that look alike can't be told apart by where the maps lie to each other, which nobody knows. So more
    loops have to agree than within one map.

    Args:
        graph: before.
        pair: the keyframes, one of each map, registered.
        config: settings.
    """
    if not confirms_loop(pair.found, config):
        return graph, False
    graph = with_candidate(graph, pair.edge, config)
    maps = maps_of(graph)
    ends = {int(maps[pair.target]), int(maps[pair.source])}
    between = [c for c in graph.candidates if {int(maps[c.target]), int(maps[c.source])} == ends]
    bridges = agreeing(graph, between, config, least=config.map_support)
    if not bridges:
        return graph, False
    left = tuple(c for c in graph.candidates if not any(c is used for used in between))
    return replace(merged(with_adjustment_taken(graph), maps, bridges), candidates=left), True


def merged(graph: KeyframeGraph, maps: Int[np.ndarray, " n"], bridges: Sequence[Edge]) -> KeyframeGraph:
    """The graph with two maps tied by edges; the later map moves to where the first of these puts it.

    Args:
        graph: before.
        maps: map of each of its n keyframes.
        bridges: registrations between the two, at least one.
    """
    edge, noise = bridges[0], replace(graph.noise, redundancy=1.0)
    T_target_source = se3.matrices_of(motions_of([edge], graph.depth_parameters))[0]
    fixed, moving, motion, by_depth = edge.target, edge.source, T_target_source, edge.sensitivity
    if maps[fixed] > maps[moving]:
        fixed, moving, motion = moving, fixed, np.linalg.inv(T_target_source)
        by_depth = -se3.adjoints_of(T_target_source[None])[0] @ by_depth
    rows = np.flatnonzero(maps == maps[moving])
    T = se3.matrices_of(graph.poses)
    from_moving = np.linalg.inv(T[moving]) @ T[rows]
    poses, covariances = graph.poses.copy(), graph.covariances.copy()
    poses[rows] = se3.parameters_of(T[fixed] @ motion @ from_moving)
    # Errors of the two maps and of the tie between them add up.
    tie = np.linalg.inv(noise.share(edge.information[None]))
    known = se3.composed_covariances(covariances[[fixed]], motion[None], tie) + covariances[moving]
    known = np.broadcast_to(known, (len(rows), 6, 6))
    covariances[rows] = se3.composed_covariances(known, from_moving, covariances[rows])
    sensitivities = graph.depth_sensitivities.copy()
    tied = drift_of_followers(sensitivities[fixed], motion[None])[0] + by_depth
    sensitivities[rows] += drift_of_followers(tied - sensitivities[moving], from_moving)
    edges = tuple(replace(bridge, revisit=True) for bridge in bridges)
    return replace(
        graph,
        poses=poses,
        covariances=covariances,
        depth_sensitivities=sensitivities,
        edges=(*graph.edges, *edges),
    )
