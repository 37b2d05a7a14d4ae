"""Elimination plan: the fronts of the multifrontal method in batches, and the place of every block in them.

The nodes at one depth of the elimination tree are independent. Those of about the same size are factorised as
one batch of dense matrices, padded to one size.

Source: Duff and Reid, The multifrontal solution of indefinite sparse symmetric linear systems (1983).
"""

from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Int

from sfgs_jax.factor_graph.problem._capacities import BatchSize, capacity_for
from sfgs_jax.factor_graph.problem._nested_dissection import Node, dissect

_Indices = Int[Array | np.ndarray, "..."]


class FrontBatch(eqx.Module):
    """Fronts of nodes at one depth of the tree, padded to the same numbers of poses.

    A node's front is a block lower triangle over its own poses and its boundary. All fronts lie one after the
    other in one array of blocks. For each batch these are the (o + b) x o columns of all its nodes, then the
    b (b + 1) / 2 blocks of each triangle over the boundary.

    Attributes:
        own: (n, o) poses a node eliminates; P where unused.
        boundary: (n, b) poses of its ancestors that are then coupled to each other; P where unused.
        positions: (n, b) of the boundary in the parent's front; -1 where unused.
        columns: (n,) first block of the columns of the parent's front.
        triangle: (n,) first block of its triangle.
        width: (n,) columns it has room for, its o.
    """

    own: _Indices
    boundary: _Indices
    positions: _Indices
    columns: _Indices
    triangle: _Indices
    width: _Indices


class EliminationPlan(eqx.Module):
    """Fronts of a symmetric pattern of blocks.

    Attributes:
        batches: from the leaves to the root.
        places: (P + B,) place of the blocks on the diagonal, then of those off it, in the fronts; one past
            the end for an unused block.
        transposed: (B,) whether a block off the diagonal is transposed on its way into the fronts, which
            store the part below the diagonal. It is not if its second pose is eliminated first.
    """

    batches: tuple[FrontBatch, ...]
    places: _Indices
    transposed: Bool[Array | np.ndarray, " B"]

    @property
    def sizes(self) -> tuple[BatchSize, ...]:
        """Sizes of the batches, to pass on to the next plan."""
        return tuple((batch.own.shape[1], batch.boundary.shape[1]) for batch in self.batches)


class _Place(NamedTuple):
    """Place of a node's front in the array of blocks: its columns, its triangle, and the columns' room."""

    columns: int
    triangle: int
    width: int


class _NodeBatch(NamedTuple):
    """A batch of nodes, the number of fronts it has room for, and their size."""

    nodes: list[Node]
    room: int
    size: BatchSize


def plan_elimination(
    rows: Int[np.ndarray, " B"],
    columns: Int[np.ndarray, " B"],
    num_poses: int,
    given: tuple[BatchSize, ...] = (),
    least: BatchSize = (0, 0),
) -> EliminationPlan:
    """Plan for a symmetric pattern of blocks, by nested dissection.

    Args:
        rows: (B,) first pose of each block off the diagonal; `num_poses` where unused.
        columns: (B,) second pose.
        num_poses: P.
        given: sizes of the batches to keep to while they suffice.
        least: size to keep to without them.
    """
    tree = dissect(rows, columns, num_poses)
    batches = _with_sizes(
        [
            batch
            for depth in reversed(range(len(tree.depths)))
            for batch in _batches(tree.depths[depth], depth)
        ],
        given,
        least,
    )
    places, end = _front_places(batches)
    transposed = tree.order[columns] > tree.order[rows]
    later, earlier = np.where(transposed, columns, rows), np.where(transposed, rows, columns)
    return EliminationPlan(
        _front_batches(batches, places, num_poses),
        _block_places(batches, places, earlier, later, num_poses, end),
        transposed,
    )


def _batches(nodes: list[Node], depth: int) -> list[tuple[list[Node], int]]:
    """Nodes of one depth in batches with room for a count: many small fronts, and few large ones."""
    count = 2**depth
    shares = (8,) if count < 4 else (6, 2) if count < 16 else (4, 3, 1)
    nodes = sorted(nodes, key=lambda node: -node.work)
    batches = []
    for capacity in (count * share // 8 for share in reversed(shares)):
        batches.append((nodes[:capacity], capacity))
        nodes = nodes[capacity:]
    return batches


def _with_sizes(
    batches: list[tuple[list[Node], int]], given: tuple[BatchSize, ...], least: BatchSize
) -> list[_NodeBatch]:
    """Batches with the size of their fronts; the last is the root, which has no boundary."""
    known = given
    if len(given) != len(batches):
        # Uneven cuts leave some leaves large, and loops the root; there the room costs little.
        roomy = 2 * least[0], least[1]
        known = (roomy, *(least,) * (len(batches) - 2), roomy)[-len(batches) :]
    sized = []
    for (nodes, count), (own, boundary) in zip(batches, known, strict=True):
        o = capacity_for(_with_room(max((len(node.own) for node in nodes), default=0)), own)
        widest = max((len(node.boundary) for node in nodes), default=0)
        b = capacity_for(_with_room(widest), boundary) if len(sized) < len(batches) - 1 else 0
        sized.append(_NodeBatch(nodes, count, (o, b)))
    return sized


def _with_room(count: int) -> int:
    """The next larger multiple of four: one pose more or less seldom needs another size."""
    return 4 * (count // 4 + 1)


def _front_places(batches: list[_NodeBatch]) -> tuple[dict[int, _Place], int]:
    """Place of the front of each node, by the node's id, and the number of blocks of all fronts."""
    places, end = {}, 0
    for nodes, count, (o, b) in batches:
        for i, node in enumerate(nodes):
            triangle = end + count * (o + b) * o + i * (b * (b + 1) // 2)
            places[id(node)] = _Place(end + i * (o + b) * o, triangle, o)
        end += count * ((o + b) * o + b * (b + 1) // 2)
    return places, end


def _front_batches(
    batches: list[_NodeBatch], places: dict[int, _Place], num_poses: int
) -> tuple[FrontBatch, ...]:
    """Arrays of the batches."""
    parents = {id(child): node for nodes, _, _ in batches for node in nodes for child in node.children}
    row = np.zeros(num_poses, np.int32)
    laid_out = []
    for nodes, count, (o, b) in batches:
        own, boundary = np.full((count, o), num_poses, np.int32), np.full((count, b), num_poses, np.int32)
        positions = np.full((count, b), -1, np.int32)
        columns, triangle, width = (np.zeros(count, np.int32) for _ in range(3))
        for i, node in enumerate(nodes):
            own[i, : len(node.own)] = node.own
            boundary[i, : len(node.boundary)] = node.boundary
            parent = parents.get(id(node))
            if parent is not None:
                columns[i], triangle[i], width[i] = places[id(parent)]
                row[parent.own] = np.arange(len(parent.own))
                row[parent.boundary] = width[i] + np.arange(len(parent.boundary))
                positions[i, : len(node.boundary)] = row[node.boundary]
        laid_out.append(
            FrontBatch(
                own=own,
                boundary=boundary,
                positions=positions,
                columns=columns,
                triangle=triangle,
                width=width,
            )
        )
    return tuple(laid_out)


def _block_places(
    batches: list[_NodeBatch],
    places: dict[int, _Place],
    earlier: Int[np.ndarray, " B"],
    later: Int[np.ndarray, " B"],
    num_poses: int,
    end: int,
) -> Int[np.ndarray, " S"]:
    """Place of each block of the matrix: in the columns of its pose that is eliminated first."""
    found = np.full(num_poses + len(earlier), end, np.int32)
    by_pose = np.argsort(earlier, kind="stable")
    starts = np.searchsorted(earlier[by_pose], np.arange(num_poses + 1))
    row = np.zeros(num_poses, np.int32)
    for node in (node for nodes, _, _ in batches for node in nodes):
        place = places[id(node)]
        row[node.own] = np.arange(len(node.own))
        row[node.boundary] = place.width + np.arange(len(node.boundary))
        for column, pose in enumerate(node.own.tolist()):
            entries = by_pose[starts[pose] : starts[pose + 1]]
            found[num_poses + entries] = place.columns + row[later[entries]] * place.width + column
            found[pose] = place.columns + column * place.width + column
    return found
