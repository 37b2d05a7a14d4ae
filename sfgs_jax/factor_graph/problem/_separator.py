"""Vertex separator of a graph: few vertices whose removal leaves two parts of about the same size.

An edge cut from breadth-first distances (George and Liu, An automatic nested dissection algorithm for
irregular finite element problems, 1978), turned into a vertex separator by a minimum vertex cover.
"""

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Bool, Float
from scipy.sparse.csgraph import connected_components, dijkstra, maximum_bipartite_matching

LEAST_SHARE = 0.4
"""Least share of the vertices on either side of a cut."""

CUTS = 9
"""Cuts tried between these shares."""

IMBALANCE = 0.05
"""Penalty per vertex of imbalance, in vertices of the separator."""


def vertex_separator(
    adjacency: sparse.csr_array,
) -> tuple[Bool[np.ndarray, " n"], list[Bool[np.ndarray, " n"]]]:
    """Masks of a small separator and of the two parts it leaves; a part may be empty.

    Balanced parts keep an elimination tree shallow, and the fronts at one depth of about one size, so little
    is padded.

    Args:
        adjacency: (n, n) symmetric pattern.
    """
    count = len(adjacency.indptr) - 1
    rank = np.argsort(np.argsort(_across(adjacency), kind="stable"), kind="stable")
    best, least = rank < 0, np.inf
    for size in np.unique(np.linspace(LEAST_SHARE * count, (1 - LEAST_SHARE) * count, CUTS).astype(int)):
        first = rank < size
        for side in (first, ~first):
            ends = int((side & ((adjacency @ (~side).astype(np.int8)) > 0)).sum())
            badness = ends + IMBALANCE * abs(count - 2 * int(side.sum()) + ends)
            if badness < least:
                best, least = first, badness
    separator = minimum_vertex_cover(adjacency, best)
    return separator, [best & ~separator, ~best & ~separator]


def minimum_vertex_cover(
    adjacency: sparse.csr_array, first: Bool[np.ndarray, " n"]
) -> Bool[np.ndarray, " n"]:
    """Minimum vertex cover of the edges between two sets of vertices, by König's theorem.

    It has one end of each edge of a maximum matching. Alternating paths from the unmatched vertices of the
    first set decide which end: the cover takes the vertices of the first set that they do not reach, and the
    vertices of the second set that they reach.

    Args:
        adjacency: (n, n) symmetric pattern.
        first: (n,) the vertices of the first set; the others are the second.
    """
    left, right = np.flatnonzero(first), np.flatnonzero(~first)
    across = adjacency[left][:, right]
    match = maximum_bipartite_matching(across, perm_type="column")
    matched = match >= 0
    reached, found = np.zeros(len(right), bool), ~matched
    frontier = found.copy()
    while frontier.any():
        new = ((frontier.astype(np.int32) @ across) > 0) & ~reached
        reached |= new
        frontier = np.zeros(len(left), bool)
        frontier[matched] = new[match[matched]]
        frontier &= ~found
        found |= frontier
    cover = np.zeros(len(first), bool)
    cover[left[~found & matched]], cover[right[reached]] = True, True
    return cover


def _across(adjacency: sparse.csr_array) -> Float[np.ndarray, " n"]:
    """Difference of the distances from two pseudo-peripheral vertices: it grows from end to end of the graph.

    Vertices of one difference lie straight across the graph; vertices at one distance from a single end lie
    along an arc. Smaller components come before and after the largest, so a cut in the middle goes through
    the largest.
    """
    _, component = connected_components(adjacency, directed=False)
    sizes = np.bincount(component)
    largest = component == np.argmax(sizes)
    distances = [np.where(largest, 0, -1.0)]
    for _ in range(3):
        start = int(np.argmax(distances[-1]))
        reached = dijkstra(adjacency, directed=False, indices=start, unweighted=True)
        distances.append(np.where(largest, reached, -1.0))
    by_size = np.argsort(np.argsort(sizes, kind="stable"), kind="stable")[component]
    aside = len(component) + by_size
    return np.where(largest, distances[-2] - distances[-1], np.where(by_size % 2 == 0, aside, -aside))
