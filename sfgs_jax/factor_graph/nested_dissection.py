"""Order of elimination of a large pose graph: nested dissection, on the host, once per graph.

A separator of few poses splits the graph into two halves that don't touch; each half is split in turn. The
halves come first in the elimination, so all nodes at one depth of the resulting tree are independent of each
other and are factorised as one batch of dense matrices.

Source: George and Liu, An automatic nested dissection algorithm for irregular finite element problems (1978),
for separators from breadth-first levels; Duff and Reid, The multifrontal solution of indefinite sparse
symmetric linear systems (1983), for the fronts.
"""

from dataclasses import dataclass, field

import equinox as eqx
import numpy as np
import scipy.sparse as sparse
from jaxtyping import Array, Bool, Int
from scipy.sparse.csgraph import dijkstra

LEAF_POSES = 12
"""A part of so few poses is eliminated at once."""

_Indices = Int[Array | np.ndarray, "..."]


class Level(eqx.Module):
    """Nodes at one depth of the tree, padded to the same number of own and boundary poses.

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


@dataclass
class _Node:
    own: np.ndarray
    depth: int
    children: list["_Node"] = field(default_factory=list)
    boundary: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    index: int = 0


def plan_elimination(
    rows: Int[np.ndarray, " B"], columns: Int[np.ndarray, " B"], num_poses: int
) -> EliminationPlan:
    """Plan for a symmetric pattern of blocks.

    Args:
        rows: first pose of each block off the diagonal; `num_poses` where unused.
        columns: second pose.
        num_poses: P.
    """
    used = rows < num_poses
    a, b = rows[used].astype(np.int64), columns[used].astype(np.int64)
    ones = np.ones(2 * len(a), np.int8)
    adjacency = sparse.csr_array(
        (ones, (np.concatenate([a, b]), np.concatenate([b, a]))), (num_poses, num_poses)
    )
    root = _dissect(adjacency, np.arange(num_poses), 0)
    depths: list[list[_Node]] = []
    _collect(root, depths)
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
    return EliminationPlan(_levels(depths, order, owner, rows, columns, num_poses), transposed)


def _dissect(adjacency: sparse.csr_array, poses: np.ndarray, depth: int) -> _Node:
    if len(poses) <= LEAF_POSES:
        return _Node(poses, depth)
    within = adjacency[poses][:, poses]
    distance = _levels_from_afar(within)
    counts = np.bincount(distance)
    before = np.concatenate([[0], np.cumsum(counts)[:-1]])
    after = len(poses) - before - counts
    balanced = np.minimum(before, after) >= 0.25 * len(poses)
    if not balanced.any():
        balanced = np.minimum(before, after) == np.minimum(before, after).max()
    if np.minimum(before, after).max() == 0:
        return _Node(poses, depth)  # everything neighbours everything: nothing to split
    cut = int(np.flatnonzero(balanced)[np.argmin(counts[balanced])])
    beyond = (distance == cut + 1).astype(np.int8)
    separator = (distance == cut) & ((within @ beyond) > 0)
    first, second = (distance <= cut) & ~separator, distance > cut
    node = _Node(poses[separator], depth)
    node.children = [_dissect(adjacency, poses[part], depth + 1) for part in (first, second)]
    return node


def _levels_from_afar(adjacency: sparse.csr_array) -> np.ndarray:
    """Breadth-first level of each vertex, from one at the far end; what can't be reached comes after."""
    distance = np.zeros(len(adjacency.indptr) - 1)
    for _ in range(3):
        start = int(np.argmax(np.where(np.isfinite(distance), distance, -1)))
        distance = dijkstra(adjacency, directed=False, indices=start, unweighted=True)
    # The empty level between keeps the parts apart.
    reached = np.isfinite(distance)
    return np.where(reached, distance, distance[reached].max() + 2).astype(np.int64)


def _collect(node: _Node, depths: list[list[_Node]]) -> None:
    while len(depths) <= node.depth:
        depths.append([])
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
) -> tuple[Level, ...]:
    depth_of = np.zeros(num_poses + 1, np.int64)
    for depth, nodes in enumerate(depths):
        for node in nodes:
            depth_of[node.own] = depth
    owns = [max(1, max(len(n.own) for n in nodes)) for nodes in depths]
    bounds = [max(len(n.boundary) for n in nodes) for nodes in depths]
    used = rows < num_poses
    first = np.where(order[rows] < order[columns], rows, columns)
    second = np.where(order[rows] < order[columns], columns, rows)
    slots = num_poses + np.arange(len(rows))

    levels = []
    for depth in reversed(range(len(depths))):
        nodes, o, b = depths[depth], owns[depth], bounds[depth]
        own = np.full((len(nodes), o), num_poses, np.int32)
        boundary = np.full((len(nodes), b), num_poses, np.int32)
        parent = np.zeros(len(nodes), np.int32)
        above = owns[depth - 1] + bounds[depth - 1] if depth else 0
        positions = np.full((len(nodes), b), above, np.int32)
        # Position of a pose in each front: found in a table per node, for all its blocks at once.
        place = np.zeros((len(nodes), num_poses), np.int32)
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
        levels.append(
            Level(own, boundary, sources.astype(np.int32), places.astype(np.int32), parent, positions)
        )
    return tuple(levels)
