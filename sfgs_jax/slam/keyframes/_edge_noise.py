"""Noise of the edges, told by the run itself.

GICP's information says how well a registration's points fix its motion if their errors are independent. They
are not: the distortion of depth, its quantisation and the facets of a surface pull all points of an image
alike. Registrations around three keyframes should lead back to the start. By how much they miss it tells
what the information leaves out, with this camera and at this place.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._edges import motions_of
from sfgs_jax.slam.state._keyframe_graph import Edge, EdgeNoise, KeyframeGraph

_NEWEST = 256
"""Edges that are looked at: those of some thirty keyframes."""
_PRIOR_CYCLES = 10
"""Cycles that weigh as much as what the settings say. It takes about as many numbers to know a variance to a
third of it."""
_TAIL = 5
"""Degrees of freedom of the Student distribution of the cycles' errors; some go through wrong edges."""
_ROUNDS = 10
"""Reweightings, after which the covariance changes by less than a hundredth."""


def prior_noise(config: GraphConfig) -> EdgeNoise:
    """Noise of edges as known before the first cycle.

    Args:
        config: settings.
    """
    return EdgeNoise(np.diag(np.repeat([config.edge_sigma_metres, config.edge_sigma_radians], 3) ** 2), 1.0)


def edge_noise(graph: KeyframeGraph, config: GraphConfig) -> EdgeNoise:
    """Noise of a graph's edges by its newest cycles; where there are few, by the settings.

    The covariance is the most likely one if the cycles' errors have a Student distribution, with an inverse
    Wishart prior around the settings'.

    Args:
        graph: with its edges.
        config: settings.
    """
    steady = [edge for edge in graph.edges if not edge.loop]
    newest = steady[-_NEWEST:]
    # As many edges as a tree has close no cycle.
    independent = len(newest) - _edges_of_a_tree(newest)
    errors, prior = _around(newest, graph.offsets), prior_noise(config).covariance
    covariance = prior
    for _ in range(_ROUNDS if len(errors) else 0):
        # Three edges err around a cycle.
        surprise = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(3 * covariance), errors)
        weight = (_TAIL + 6) / (_TAIL + surprise)
        seen = np.einsum("n,ni,nj->ij", weight, errors, errors) / (3 * len(errors))
        covariance = (_PRIOR_CYCLES * prior + independent * seen) / (_PRIOR_CYCLES + independent)
    return EdgeNoise(covariance, max(1.0, len(steady) / max(1, _edges_of_a_tree(steady))))


def _edges_of_a_tree(edges: Sequence[Edge]) -> int:
    """Edges that would tie the same keyframes without a cycle."""
    return len({number for edge in edges for number in (edge.target, edge.source)}) - 1


def _around(edges: Sequence[Edge], offsets: Float[np.ndarray, " G"]) -> Float[np.ndarray, "n 6"]:
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
    T = se3.matrices_of(motions_of(edges, offsets, surface_only=True))
    first, second, whole = np.asarray(cycles, int).T
    return se3.logs_of(np.linalg.inv(T[whole]) @ T[first] @ T[second])
