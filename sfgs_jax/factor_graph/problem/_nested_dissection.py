"""Nested dissection: the elimination tree of a large pose graph, built on the host, once per graph.

A separator of few poses splits the graph into two parts without a common edge; each part is split in turn.
The parts are eliminated before their separator, so the nodes at one depth of the tree are independent.

Source: George and Liu, An automatic nested dissection algorithm for irregular finite element problems (1978).
"""

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sparse
from jaxtyping import Int

from sfgs_jax.factor_graph.problem._separator import vertex_separator

LEAF_POSES = 12
"""Most poses of a part that is eliminated at once. Leaves at the greatest depth have up to twice as many."""


@dataclass
class Node:
    """A node of the elimination tree: a separator, or a part that is not split."""

    own: Int[np.ndarray, " o"]
    """Poses that the node eliminates."""

    depth: int
    """Distance from the root."""

    children: list["Node"] = field(default_factory=list)
    """Nodes of the parts that the separator leaves."""

    boundary: Int[np.ndarray, " b"] = field(default_factory=lambda: np.zeros(0, np.int64))
    """Poses of its ancestors that eliminating it couples, in the order of their elimination."""

    @property
    def work(self) -> int:
        """Estimate of the work on its front, in any unit."""
        return (len(self.own) + 1) * (len(self.own) + len(self.boundary)) ** 2


@dataclass(frozen=True)
class EliminationTree:
    """Elimination tree of a symmetric pattern of blocks."""

    depths: list[list[Node]]
    """Nodes at each depth, from the root on."""

    order: Int[np.ndarray, " n"]
    """(P + 1,) place of each pose in the order of elimination; P for the pose P, which stands for unused."""


def dissect(rows: Int[np.ndarray, " B"], columns: Int[np.ndarray, " B"], num_poses: int) -> EliminationTree:
    """Elimination tree by nested dissection. The number of poses alone decides its depth.

    Args:
        rows: (B,) first pose of each block off the diagonal; `num_poses` where unused.
        columns: (B,) second pose.
        num_poses: P.
    """
    used = rows < num_poses
    a, b = rows[used].astype(np.int64), columns[used].astype(np.int64)
    ones = np.ones(2 * len(a), np.int8)
    adjacency = sparse.csr_array(
        (ones, (np.concatenate([a, b]), np.concatenate([b, a]))), (num_poses, num_poses)
    )
    deepest = max(0, (num_poses // LEAF_POSES).bit_length() - 1)
    depths: list[list[Node]] = [[] for _ in range(deepest + 1)]
    tied = np.diff(adjacency.indptr) > 0
    _collect(_split(adjacency, np.flatnonzero(tied), np.flatnonzero(~tied), 0, deepest), depths)
    from_leaves = [node for nodes in reversed(depths) for node in nodes]
    order = np.full(num_poses + 1, num_poses)
    count = 0
    for node in from_leaves:
        order[node.own] = count + np.arange(len(node.own))
        count += len(node.own)
    for node in from_leaves:
        reached = [adjacency[node.own].indices.astype(np.int64), *(c.boundary for c in node.children)]
        around = np.unique(np.concatenate(reached))
        last = order[node.own].max() if len(node.own) else -1
        above = around[order[around] > last]
        node.boundary = above[np.argsort(order[above])]
    return EliminationTree(depths, order)


def _split(
    adjacency: sparse.csr_array,
    poses: Int[np.ndarray, " n"],
    single: Int[np.ndarray, " m"],
    depth: int,
    deepest: int,
) -> Node:
    """Tree over some poses, and single ones that are tied to none: they fill the smaller part.

    A graph that grows has many of those at first. Kept together they would make a leaf of their own size.
    """
    if depth == deepest or len(poses) + len(single) <= LEAF_POSES:
        return Node(np.concatenate([poses, single]), depth)
    separator, parts = poses[:0], [poses[:0], poses[:0]]
    if len(poses) > LEAF_POSES:
        found, sides = vertex_separator(adjacency[poses][:, poses])
        if all(side.any() for side in sides):
            separator, parts = poses[found], [poses[side] for side in sides]
    if not len(parts[0]):
        separator = poses  # few poses, or a complete graph, which has no separator
        if not len(single):
            return Node(separator, depth)
    node = Node(separator, depth)
    first = np.clip((len(single) + len(parts[1]) - len(parts[0])) // 2, 0, len(single))
    for part, alone in zip(parts, (single[:first], single[first:]), strict=True):
        node.children.append(_split(adjacency, part, alone, depth + 1, deepest))
    return node


def _collect(node: Node, depths: list[list[Node]]) -> None:
    """Append the nodes of a tree to the lists of their depths."""
    depths[node.depth].append(node)
    for child in node.children:
        _collect(child, depths)
