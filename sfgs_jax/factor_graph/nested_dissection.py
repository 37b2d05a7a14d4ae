"""Order of elimination of a large pose graph: nested dissection, on the host, once per graph.

A separator of few poses splits the graph into two halves that don't touch; each half is split in turn. The
halves come first in the elimination, so all nodes at one depth of the resulting tree are independent of each
other and are factorised as one batch of dense matrices.

Source: George and Liu, An automatic nested dissection algorithm for irregular finite element problems (1978),
for separators from breadth-first distances; Duff and Reid, The multifrontal solution of indefinite sparse
symmetric linear systems (1983), for the fronts.
"""

from dataclasses import dataclass, field

import equinox as eqx
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse.csgraph import connected_components, dijkstra

from sfgs_jax.factor_graph.capacities import LevelSize, capacity_for

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


class Level(eqx.Module):
    """Nodes at one depth of the tree, two to the power of that depth, padded to the same numbers of poses.

    Attributes:
        own: (n, o) poses a node eliminates; P where unused.
        boundary: (n, b) poses of its ancestors that are then coupled to each other; P where unused.
        sources: (e,) blocks that enter the fronts here: diagonal blocks, then those off it; P + B for none.
        places: (e,) where they go: block of the n (o + b) x o front columns, or one past the end.
        parent: (n,) node of the next level up.
        positions: (n, b) of the boundary in the parent's front; o + b of the parent where unused.
    """

    own: _Indices
    boundary: _Indices
    sources: _Indices
    places: _Indices
    parent: _Indices
    positions: _Indices


class EliminationPlan(eqx.Module):
    """Tree of fronts.

    Attributes:
        levels: from the leaves to the root.
        transposed: (B,) blocks off the diagonal whose second pose is eliminated before the first keep their
            orientation, the others are transposed: what is stored lies below the diagonal.
    """

    levels: tuple[Level, ...]
    transposed: Bool[Array | np.ndarray, " B"]

    @property
    def sizes(self) -> tuple[LevelSize, ...]:
        """Of the levels, to pass on to the next plan."""
        return tuple((v.own.shape[1], v.boundary.shape[1], v.sources.shape[0]) for v in self.levels)


@dataclass
class _Node:
    own: np.ndarray
    depth: int
    children: list["_Node"] = field(default_factory=list)
    boundary: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    index: int = 0


def plan_elimination(
    rows: Int[np.ndarray, " B"],
    columns: Int[np.ndarray, " B"],
    num_poses: int,
    given: tuple[LevelSize, ...] = (),
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
    order = np.zeros(num_poses + 1, np.int64)
    order[num_poses] = num_poses
    owner = np.zeros(num_poses, np.int64)
    count = 0
    for nodes in reversed(depths):
        for i, node in enumerate(nodes):
            node.index = i
            order[node.own] = count + np.arange(len(node.own))
            owner[node.own] = i
            count += len(node.own)
    for nodes in reversed(depths):
        for node in nodes:
            reached = [adjacency[node.own].indices.astype(np.int64), *(c.boundary for c in node.children)]
            around = np.unique(np.concatenate(reached))
            last = order[node.own].max() if len(node.own) else -1
            above = around[order[around] > last] if len(node.own) else around
            node.boundary = above[np.argsort(order[above])]
    transposed = order[columns] > order[rows]
    return EliminationPlan(_levels(depths, order, owner, rows, columns, num_poses, given), transposed)


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
    best, least = (np.zeros(count, bool), [np.zeros(count, bool)] * 2), np.inf
    for size in np.unique(np.linspace(LEAST_SHARE * count, (1 - LEAST_SHARE) * count, CUTS).astype(int)):
        first = rank < size
        for side in (first, ~first):
            separator = side & ((adjacency @ (~side).astype(np.int8)) > 0)
            parts = [first & ~separator, ~first & ~separator]
            badness = separator.sum() + IMBALANCE * abs(int(parts[0].sum()) - int(parts[1].sum()))
            if badness < least:
                best, least = (separator, parts), badness
    return best


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


def _levels(
    depths: list[list[_Node]],
    order: np.ndarray,
    owner: np.ndarray,
    rows: np.ndarray,
    columns: np.ndarray,
    num_poses: int,
    given: tuple[LevelSize, ...],
) -> tuple[Level, ...]:
    depth_of = np.zeros(num_poses + 1, np.int64)
    for depth, nodes in enumerate(depths):
        for node in nodes:
            depth_of[node.own] = depth
    known = given[::-1] if len(given) == len(depths) else ((0, 0, 0),) * len(depths)
    owns = [
        capacity_for(_with_room(max((len(n.own) for n in nodes), default=0)), size[0])
        for nodes, size in zip(depths, known, strict=True)
    ]
    bounds = [
        capacity_for(_with_room(max((len(n.boundary) for n in nodes), default=0)), size[1]) if depth else 0
        for depth, (nodes, size) in enumerate(zip(depths, known, strict=True))
    ]
    used = rows < num_poses
    first = np.where(order[rows] < order[columns], rows, columns)
    second = np.where(order[rows] < order[columns], columns, rows)
    slots = num_poses + np.arange(len(rows))

    levels = []
    for depth in reversed(range(len(depths))):
        nodes, o, b = depths[depth], owns[depth], bounds[depth]
        count = 2**depth
        own = np.full((count, o), num_poses, np.int32)
        boundary = np.full((count, b), num_poses, np.int32)
        parent = np.zeros(count, np.int32)
        above = owns[depth - 1] + bounds[depth - 1] if depth else 0
        positions = np.full((count, b), above, np.int32)
        # Position of a pose in each front: found in a table per node, for all its blocks at once.
        place = np.zeros((count, num_poses), np.int32)
        for i, node in enumerate(nodes):
            own[i, : len(node.own)] = node.own
            boundary[i, : len(node.boundary)] = node.boundary
            place[i, node.own] = np.arange(len(node.own))
            place[i, node.boundary] = o + np.arange(len(node.boundary))
        if depth:
            for p, node in enumerate(depths[depth - 1]):
                for child in node.children:
                    parent[child.index] = p
                    at = {int(v): k for k, v in enumerate(node.own)}
                    at |= {int(v): owns[depth - 1] + k for k, v in enumerate(node.boundary)}
                    positions[child.index, : len(child.boundary)] = [at[int(v)] for v in child.boundary]
        here = np.flatnonzero(used & (depth_of[first] == depth))
        i, u, v = owner[first[here]], first[here], second[here]
        poses = np.flatnonzero(depth_of[:num_poses] == depth)
        j = owner[poses]
        places = np.concatenate(
            [
                (j * (o + b) + place[j, poses]) * o + place[j, poses],
                (i * (o + b) + place[i, v]) * o + place[i, u],
            ]
        )
        sources = np.concatenate([poses, slots[here]])
        unused = capacity_for(_with_room(len(sources)), known[depth][2]) - len(sources)
        sources = np.append(sources, np.full(unused, num_poses + len(rows)))
        places = np.append(places, np.full(unused, count * (o + b) * o))
        levels.append(
            Level(own, boundary, sources.astype(np.int32), places.astype(np.int32), parent, positions)
        )
    return tuple(levels)


def _with_room(count: int) -> int:
    """The next multiple of four beyond: a pose more or less seldom needs another size."""
    return 4 * (count // 4 + 1)
