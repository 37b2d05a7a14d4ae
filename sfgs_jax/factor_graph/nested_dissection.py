"""Order of elimination of a large pose graph: nested dissection, on the host, once per graph.

A separator of few poses splits the graph into two halves that don't touch; each half is split in turn. The
halves come first in the elimination, so all nodes at one depth of the resulting tree are independent of each
other; those of about the same size are factorised as one batch of dense matrices.

Source: George and Liu, An automatic nested dissection algorithm for irregular finite element problems (1978),
for separators from breadth-first distances; Duff and Reid, The multifrontal solution of indefinite sparse
symmetric linear systems (1983), for the fronts.
"""

from dataclasses import dataclass, field

import equinox as eqx
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse.csgraph import connected_components, dijkstra, maximum_bipartite_matching

from sfgs_jax.factor_graph.capacities import BatchSize, capacity_for

LEAF_POSES = 12
"""A part of at most so many poses is eliminated at once; leaves that go to the greatest depth have up to
twice as many."""

LEAST_SHARE = 0.4
"""Share of the poses that either side of a cut has at least."""

CUTS = 9
"""Cuts tried between these shares."""

IMBALANCE = 0.05
"""How many poses more a separator may have for each pose by which it makes its parts more alike."""

_Indices = Int[Array | np.ndarray, "..."]


class Batch(eqx.Module):
    """Nodes at one depth of the tree, padded to the same numbers of poses.

    A node's front is a block lower triangle over its own poses and those of its boundary. All fronts lie one
    after the other in one array of blocks: the (o + b) x o columns of a batch's nodes, then the b (b + 1) / 2
    blocks of the triangle over the boundary.

    Attributes:
        own: (n, o) poses a node eliminates; P where unused.
        boundary: (n, b) poses of its ancestors that are then coupled to each other; P where unused.
        positions: (n, b) of the boundary in the parent's front; -1 where unused.
        columns: (n,) where the columns of the parent's front begin.
        triangle: (n,) where its triangle begins.
        width: (n,) columns it has room for, its o.
    """

    own: _Indices
    boundary: _Indices
    positions: _Indices
    columns: _Indices
    triangle: _Indices
    width: _Indices


class EliminationPlan(eqx.Module):
    """Tree of fronts.

    Attributes:
        batches: from the leaves to the root.
        places: (P + B,) where the blocks on the diagonal, then those off it, enter the fronts; one past the
            end for what is unused.
        transposed: (B,) blocks off the diagonal whose second pose is eliminated before the first keep their
            orientation, the others are transposed: what is stored lies below the diagonal.
    """

    batches: tuple[Batch, ...]
    places: _Indices
    transposed: Bool[Array | np.ndarray, " B"]

    @property
    def sizes(self) -> tuple[BatchSize, ...]:
        """Of the batches, to pass on to the next plan."""
        return tuple((batch.own.shape[1], batch.boundary.shape[1]) for batch in self.batches)


@dataclass
class _Node:
    own: np.ndarray
    depth: int
    children: list["_Node"] = field(default_factory=list)
    boundary: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    columns: int = 0
    triangle: int = 0
    width: int = 0

    @property
    def work(self) -> int:
        """Grows as the time its front takes."""
        return (len(self.own) + 1) * (len(self.own) + len(self.boundary)) ** 2


def plan_elimination(
    rows: Int[np.ndarray, " B"],
    columns: Int[np.ndarray, " B"],
    num_poses: int,
    given: tuple[BatchSize, ...] = (),
) -> EliminationPlan:
    """Plan for a symmetric pattern of blocks. The depth of its tree is given by the number of poses alone.

    Args:
        rows: first pose of each block off the diagonal; `num_poses` where unused.
        columns: second pose.
        num_poses: P.
        given: sizes of the levels to keep to while they suffice.
    """
    used = rows < num_poses
    a, b = rows[used].astype(np.int64), columns[used].astype(np.int64)
    ones = np.ones(2 * len(a), np.int8)
    adjacency = sparse.csr_array(
        (ones, (np.concatenate([a, b]), np.concatenate([b, a]))), (num_poses, num_poses)
    )
    deepest = max(0, (num_poses // LEAF_POSES).bit_length() - 1)
    depths: list[list[_Node]] = [[] for _ in range(deepest + 1)]
    _collect(_dissect(adjacency, np.arange(num_poses), 0, deepest), depths)
    order = np.full(num_poses + 1, num_poses)
    count = 0
    for node in (node for nodes in reversed(depths) for node in nodes):
        order[node.own] = count + np.arange(len(node.own))
        count += len(node.own)
    for node in (node for nodes in reversed(depths) for node in nodes):
        reached = [adjacency[node.own].indices.astype(np.int64), *(c.boundary for c in node.children)]
        around = np.unique(np.concatenate(reached))
        last = order[node.own].max() if len(node.own) else -1
        above = around[order[around] > last]
        node.boundary = above[np.argsort(order[above])]
    batches = [batch for depth in reversed(range(len(depths))) for batch in _alike(depths[depth], depth)]
    transposed = order[columns] > order[rows]
    later, earlier = np.where(transposed, columns, rows), np.where(transposed, rows, columns)
    laid_out, end = _lay_out(batches, num_poses, given)
    return EliminationPlan(laid_out, _places(batches, earlier, later, num_poses, end), transposed)


def _dissect(adjacency: sparse.csr_array, poses: np.ndarray, depth: int, deepest: int) -> _Node:
    if depth == deepest or len(poses) <= LEAF_POSES:
        return _Node(poses, depth)
    separator, parts = _split(adjacency[poses][:, poses])
    if not all(part.any() for part in parts):
        return _Node(poses, depth)  # everything neighbours everything: nothing to split
    node = _Node(poses[separator], depth)
    node.children = [_dissect(adjacency, poses[part], depth + 1, deepest) for part in parts]
    return node


def _split(adjacency: sparse.csr_array) -> tuple[np.ndarray, list[np.ndarray]]:
    """Masks of a small separator and of the two parts it leaves, of about the same size.

    Balanced parts keep the tree shallow and the fronts at one depth alike, so that little is padded.
    """
    count = len(adjacency.indptr) - 1
    rank = np.argsort(np.argsort(_from_end_to_end(adjacency), kind="stable"), kind="stable")
    best, least = rank < 0, np.inf
    for size in np.unique(np.linspace(LEAST_SHARE * count, (1 - LEAST_SHARE) * count, CUTS).astype(int)):
        first = rank < size
        for side in (first, ~first):
            ends = int((side & ((adjacency @ (~side).astype(np.int8)) > 0)).sum())
            badness = ends + IMBALANCE * abs(count - 2 * int(side.sum()) + ends)
            if badness < least:
                best, least = first, badness
    separator = _fewest_ends(adjacency, best)
    return separator, [best & ~separator, ~best & ~separator]


def _fewest_ends(adjacency: sparse.csr_array, first: np.ndarray) -> np.ndarray:
    """Fewest vertices that all edges between the first ones and the others end in.

    By König's theorem as many as a largest matching of these edges has: those of the first that no
    alternating path from an unmatched one of them reaches, and those of the others that one does.
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
    separator = np.zeros(len(first), bool)
    separator[left[~found & matched]], separator[right[reached]] = True, True
    return separator


def _from_end_to_end(adjacency: sparse.csr_array) -> np.ndarray:
    """A number for each vertex that grows from one end of the graph to the other, in many small steps.

    The difference of the distances from both ends: where it is constant lies about straight across the graph,
    while vertices at one distance from a single end lie along an arc. If the graph is in pieces, the others
    come before and after the largest, so that a cut in the middle is one through the middle of that.
    """
    _, piece = connected_components(adjacency, directed=False)
    sizes = np.bincount(piece)
    largest = piece == np.argmax(sizes)
    distances = [np.where(largest, 0, -1.0)]
    for _ in range(3):
        start = int(np.argmax(distances[-1]))
        reached = dijkstra(adjacency, directed=False, indices=start, unweighted=True)
        distances.append(np.where(largest, reached, -1.0))
    by_size = np.argsort(np.argsort(sizes, kind="stable"), kind="stable")[piece]
    aside = len(piece) + by_size
    return np.where(largest, distances[-2] - distances[-1], np.where(by_size % 2 == 0, aside, -aside))


def _collect(node: _Node, depths: list[list[_Node]]) -> None:
    depths[node.depth].append(node)
    for child in node.children:
        _collect(child, depths)


def _alike(nodes: list[_Node], depth: int) -> list[tuple[int, list[_Node]]]:
    """Nodes of one depth in batches with their capacities: many small ones, and ever fewer large ones."""
    count = 2**depth
    shares = (8,) if count < 4 else (6, 2) if count < 16 else (4, 3, 1)
    nodes = sorted(nodes, key=lambda node: -node.work)
    batches = []
    for capacity in (count * share // 8 for share in reversed(shares)):
        batches.append((capacity, nodes[:capacity]))
        nodes = nodes[capacity:]
    return batches


def _lay_out(
    batches: list[tuple[int, list[_Node]]], num_poses: int, given: tuple[BatchSize, ...]
) -> tuple[tuple[Batch, ...], int]:
    """Arrays of the batches, and how many blocks their fronts have together."""
    known = given if len(given) == len(batches) else ((0, 0),) * len(batches)
    sizes: list[BatchSize] = []
    end = 0
    for (count, nodes), (own, boundary) in zip(batches, known, strict=True):
        o = capacity_for(_with_room(max((len(node.own) for node in nodes), default=0)), own)
        # Only the root hands nothing up.
        widest = max((len(node.boundary) for node in nodes), default=0)
        b = capacity_for(_with_room(widest), boundary) if len(sizes) < len(batches) - 1 else 0
        for i, node in enumerate(nodes):
            node.columns, node.width = end + i * (o + b) * o, o
            node.triangle = end + count * (o + b) * o + i * (b * (b + 1) // 2)
        end += count * ((o + b) * o + b * (b + 1) // 2)
        sizes.append((o, b))
    parents = {id(child): node for _, nodes in batches for node in nodes for child in node.children}
    place = np.zeros(num_poses, np.int32)
    laid_out = []
    for (count, nodes), (o, b) in zip(batches, sizes, strict=True):
        own, boundary = np.full((count, o), num_poses, np.int32), np.full((count, b), num_poses, np.int32)
        positions = np.full((count, b), -1, np.int32)
        columns, triangle, width = (np.zeros(count, np.int32) for _ in range(3))
        for i, node in enumerate(nodes):
            own[i, : len(node.own)] = node.own
            boundary[i, : len(node.boundary)] = node.boundary
            parent = parents.get(id(node))
            if parent is not None:
                place[parent.own] = np.arange(len(parent.own))
                place[parent.boundary] = parent.width + np.arange(len(parent.boundary))
                positions[i, : len(node.boundary)] = place[node.boundary]
                columns[i], triangle[i], width[i] = parent.columns, parent.triangle, parent.width
        laid_out.append(Batch(own, boundary, positions, columns, triangle, width))
    return tuple(laid_out), end


def _places(
    batches: list[tuple[int, list[_Node]]],
    earlier: np.ndarray,
    later: np.ndarray,
    num_poses: int,
    end: int,
) -> np.ndarray:
    """Where the matrix's blocks enter the fronts: in the columns of the pose that is eliminated first."""
    places = np.full(num_poses + len(earlier), end, np.int32)
    by_pose = np.argsort(earlier, kind="stable")
    starts = np.searchsorted(earlier[by_pose], np.arange(num_poses + 1))
    row = np.zeros(num_poses, np.int32)
    for node in (node for _, nodes in batches for node in nodes):
        row[node.own] = np.arange(len(node.own))
        row[node.boundary] = node.width + np.arange(len(node.boundary))
        for column, pose in enumerate(node.own.tolist()):
            entries = by_pose[starts[pose] : starts[pose + 1]]
            places[num_poses + entries] = node.columns + row[later[entries]] * node.width + column
            places[pose] = node.columns + column * node.width + column
    return places


def _with_room(count: int) -> int:
    """The next multiple of four beyond: a pose more or less seldom needs another size."""
    return 4 * (count // 4 + 1)
