"""Noise of the edges, told by the run itself.

GICP's information says how well a registration's points fix its motion if their errors are independent. They
are not: the distortion of depth, its quantisation and the facets of a surface pull all points of an image
alike. Registrations around three keyframes should lead back to the start. What they miss it by is what the
information leaves out, with this camera and at this place.

Cycles do not show what all edges have in common: depth and times of the rows that are known only so well. The
covariances of these estimates tell that part.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._edges import motions_of, prior_noise
from sfgs_jax.slam.state._keyframe_graph import Edge, EdgeNoise, KeyframeGraph

_NEWEST = 256
"""Edges that are looked at: those of some thirty keyframes."""
_PRIOR_CYCLES = 10
"""Cycles that weigh as much as what the settings say about the axes. It takes about as many numbers to know a
variance to a third of it."""
_PRIOR_SIZES = 1
"""Cycles that weigh as much as what the settings say about the size: it differs tenfold between cameras."""
_TAIL = 5
"""Degrees of freedom of the Student distribution of the cycles' errors; some go through wrong edges."""
_ROUNDS = 10
"""Reweightings, after which the covariance changes by less than a hundredth."""


def edge_noise(graph: KeyframeGraph, config: GraphConfig) -> EdgeNoise:
    """Noise of a graph's edges by its newest cycles, or the settings, and by what the sensors leave open.

    The covariance is the most likely one if the cycles' errors have a Student distribution. Its prior is an
    inverse Wishart distribution around the settings', times a size that the cycles soon tell.

    Args:
        graph: with its edges.
        config: settings.
    """
    steady = [edge for edge in graph.edges if not edge.loop]
    newest = steady[-_NEWEST:]
    # A tree of edges closes no cycle; each edge beyond it closes one.
    independent = len(newest) - _edges_of_a_tree(newest)
    errors, prior = _around(newest, graph.depth_parameters), prior_noise(config).covariance
    usual = covariance = prior
    for _ in range(_ROUNDS if len(errors) else 0):
        # Three edges err around a cycle.
        surprise = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(3 * covariance), errors)
        weight = (_TAIL + 6) / (_TAIL + surprise)
        seen = np.einsum("n,ni,nj->ij", weight, errors, errors) / (3 * len(errors))
        size = np.trace(np.linalg.solve(usual, seen)) / 6
        prior = usual * (_PRIOR_SIZES + independent * size) / (_PRIOR_SIZES + independent)
        covariance = (_PRIOR_CYCLES * prior + independent * seen) / (_PRIOR_CYCLES + independent)
    covariance = covariance + _by_sensors(graph, newest)
    return EdgeNoise(covariance, max(1.0, len(steady) / max(1, _edges_of_a_tree(steady))))


def _by_sensors(graph: KeyframeGraph, edges: Sequence[Edge]) -> Float[np.ndarray, "6 6"]:
    """Mean covariance of edges by what is not known yet about the camera's depth and times."""
    if not edges:
        return np.zeros((6, 6))
    total, times = np.zeros((6, 6)), graph.times_covariance
    if times.any():
        moved = _by_times(graph, edges)
        # A delay moves all rows, a read-out the first and the last of them in opposite directions.
        total += (times[0, 0] + (times[1, 1] + times[2, 2]) / 12) * moved.T @ moved
    if len(graph.depth_parameters):
        for edge in edges:
            total += edge.sensitivity @ graph.depth_covariance @ edge.sensitivity.T
    return total / len(edges)


def _by_times(graph: KeyframeGraph, edges: Sequence[Edge]) -> Float[np.ndarray, "n 6"]:
    """Derivatives of edges' tangents by a time that both their keyframes are off by, 1/s."""
    targets, sources = (
        np.asarray([graph.keyframes[number].twist for number in numbers], np.float64)
        for numbers in zip(*((edge.target, edge.source) for edge in edges), strict=True)
    )
    back = np.linalg.inv(se3.matrices_of(np.stack([edge.T_target_source for edge in edges])))
    return sources - np.einsum("nij,nj->ni", se3.adjoints_of(back), targets)


def _edges_of_a_tree(edges: Sequence[Edge]) -> int:
    """Edges that would tie the same keyframes together as these do, without a cycle."""
    if not edges:
        return 0
    ends, places = np.unique([(edge.target, edge.source) for edge in edges], return_inverse=True)
    rows, columns = places.reshape(-1, 2).T
    tied = coo_array((np.ones(len(edges)), (rows, columns)), shape=(len(ends), len(ends)))
    # Each map is a tree of its own.
    return len(ends) - connected_components(tied, directed=False, return_labels=False)


def _around(edges: Sequence[Edge], depth_parameters: Float[np.ndarray, " G"]) -> Float[np.ndarray, "n 6"]:
    """Tangents of the motions around three keyframes by their surfaces; without errors these are zero."""
    number = {(edge.target, edge.source): i for i, edge in enumerate(edges)}
    into: dict[int, list[int]] = {}
    for edge in edges:
        into.setdefault(edge.source, []).append(edge.target)
    cycles = [
        (number[a, b], number[b, c], number[a, c])
        for b, c in number
        for a in into.get(b, ())
        if (a, c) in number
    ]
    if not cycles:
        return np.zeros((0, 6))
    T = se3.matrices_of(motions_of(edges, depth_parameters, surface_only=True))
    first, second, whole = np.asarray(cycles, int).T
    return se3.logs_of(np.linalg.inv(T[whole]) @ T[first] @ T[second])
