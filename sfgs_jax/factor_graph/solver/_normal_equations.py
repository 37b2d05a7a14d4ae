"""Normal equations of a graph: sums of the blocks that its factors add."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sfgs_jax.factor_graph._values import Values
from sfgs_jax.factor_graph.problem._graph import FactorGraph


class NormalEquations(eqx.Module):
    """H step = -gradient, in blocks; the blocks of fixed variables are 0, or the identity on the diagonal.

    Attributes:
        diagonal: (P, 6, 6) pose blocks; the identity for poses that are fixed or that no factor touches.
        off_diagonal: (B, 6, 6) pose-pose blocks.
        gradient: (P, 6).
        landmark_hessian: (C, m, 3, 3); the identity at unused places.
        landmark_gradient: (C, m, 3).
        cross: (C, m, w, 3, 6) landmark-pose blocks.
        losses: per factor block (N,).
        undetermined: whether no factor touches some free variable.
    """

    diagonal: Float[Array, "P 6 6"]
    off_diagonal: Float[Array, "B 6 6"]
    gradient: Float[Array, "P 6"]
    landmark_hessian: Float[Array, "C m 3 3"]
    landmark_gradient: Float[Array, "C m 3"]
    cross: Float[Array, "C m w 3 6"]
    losses: tuple[Float[Array, "..."], ...]
    undetermined: Bool[Array, ""]


def build_normal_equations(graph: FactorGraph, values: Values) -> NormalEquations:
    """Normal equations at the given values.

    Args:
        graph: factors and structure.
        values: poses and landmarks to linearise at.
    """
    s, dtype = graph.structure, values.poses.wxyz_xyz.dtype
    P, B = graph.num_poses, s.rows.shape[0]
    (C, m), w = s.cluster_landmarks.shape, s.cluster_poses.shape[1]
    blocks = jnp.zeros((P + B + 1, 6, 6), dtype)
    gradient = jnp.zeros((P, 6), dtype)
    landmarks = jnp.zeros((C * m + 1, 12), dtype)
    cross = jnp.zeros((C * m * w + 1, 18), dtype)
    losses = []
    for i, factor in enumerate(graph.factors):
        terms = factor.terms(values)
        losses.append(terms.losses)
        M, k = s.groups[i].shape
        blocks = add_pose_blocks(graph, i, terms.pose_hessian.reshape(M, k, 6, k, 6), blocks)
        gradient = add_pose_rows(graph, i, terms.pose_gradient.reshape(M, k, 6), gradient)
        landmark_slots, cross_slots = s.landmark_slots[i], s.cross_slots[i]
        if landmark_slots is not None and cross_slots is not None:
            assert terms.landmark_hessian is not None
            assert terms.landmark_gradient is not None
            assert terms.cross is not None
            flat = [terms.landmark_hessian.reshape(-1, 9), terms.landmark_gradient]
            landmarks = landmarks.at[jnp.asarray(landmark_slots)].add(jnp.concatenate(flat, axis=1))
            cross = cross.at[jnp.asarray(cross_slots).reshape(-1)].add(terms.cross.reshape(-1, 18))

    diagonal, off_diagonal, known = hold_fixed(graph, blocks)
    point = landmarks[:-1].reshape(C, m, 12)
    hessian, solved = _hold_fixed_landmarks(graph, point[..., :9].reshape(C, m, 3, 3))
    seen_by_known = jnp.append(known, False)[jnp.asarray(s.cluster_poses)]
    coupled = solved[:, :, None] & seen_by_known[:, None]
    wanted = jnp.sum(jnp.asarray(graph.free_landmarks).astype(jnp.int32))
    too_few = jnp.sum(solved.astype(jnp.int32)) < wanted
    return NormalEquations(
        diagonal=diagonal,
        off_diagonal=off_diagonal,
        gradient=jnp.where(known[:, None], gradient, 0),
        landmark_hessian=hessian,
        landmark_gradient=jnp.where(solved[..., None], point[..., 9:], 0),
        cross=jnp.where(coupled[..., None, None], cross[:-1].reshape(C, m, w, 3, 6), 0),
        losses=tuple(losses),
        undetermined=jnp.any(jnp.asarray(graph.free_poses) & ~known) | too_few,
    )


def add_pose_blocks(
    graph: FactorGraph, i: int, hessian: Float[Array, "M k d k d"], blocks: Float[Array, "S d d"]
) -> Float[Array, "S d d"]:
    """Add the groups of one factor block to the pose-pose blocks.

    Args:
        graph: structure.
        i: number of the factor block.
        hessian: (M, k, d, k, d) blocks of each group.
        blocks: (P + B + 1, d, d) sums so far; the last takes what is not stored.
    """
    slots = jnp.asarray(graph.structure.pose_slots[i])
    k, d = slots.shape[1], blocks.shape[1]
    flat = blocks.reshape(-1, d * d)
    for a in range(k):
        for b in range(k):
            flat = flat.at[slots[:, a, b]].add(hessian[:, a, :, b].reshape(len(slots), d * d))
    return flat.reshape(blocks.shape)


def add_pose_rows(
    graph: FactorGraph, i: int, rows: Float[Array, "M k ..."], sums: Float[Array, "P ..."]
) -> Float[Array, "P ..."]:
    """Add the groups of one factor block to the rows of the poses.

    Args:
        graph: structure.
        i: number of the factor block.
        rows: (M, k, ...) rows of each group.
        sums: (P, ...) sums so far.
    """
    groups = jnp.asarray(graph.structure.groups[i]).reshape(-1)
    padded = jnp.concatenate([sums, jnp.zeros_like(sums[:1])])
    return padded.at[groups].add(rows.reshape(len(groups), *sums.shape[1:]))[:-1]


def hold_fixed(
    graph: FactorGraph, blocks: Float[Array, "S d d"]
) -> tuple[Float[Array, "P d d"], Float[Array, "B d d"], Bool[Array, " P"]]:
    """Blocks on and off the diagonal with the identity, and zeros beside it, for poses that stay.

    These are the fixed poses, and poses that no factor touches.

    Args:
        graph: structure and free poses.
        blocks: (P + B + 1, d, d) sums of the factors.

    Returns:
        Blocks on the diagonal, blocks off it, and the poses to solve for.
    """
    s, P = graph.structure, graph.num_poses
    diagonal = blocks[:P]
    known = jnp.asarray(graph.free_poses) & jnp.any(jnp.diagonal(diagonal, axis1=1, axis2=2) > 0, axis=1)
    one = jnp.eye(blocks.shape[1], dtype=blocks.dtype)[None]
    diagonal = jnp.where(known[:, None, None], diagonal, one)
    known_or_none = jnp.append(known, False)
    both = known_or_none[jnp.asarray(s.rows)] & known_or_none[jnp.asarray(s.columns)]
    return diagonal, jnp.where(both[:, None, None], blocks[P:-1], 0), known


def _hold_fixed_landmarks(
    graph: FactorGraph, hessian: Float[Array, "C m 3 3"]
) -> tuple[Float[Array, "C m 3 3"], Bool[Array, "C m"]]:
    """Blocks of the landmarks to solve for, the identity at other places, and the places to solve for."""
    places = jnp.asarray(graph.structure.cluster_landmarks)
    free = jnp.append(jnp.asarray(graph.free_landmarks), False)[places]
    # A row sees every landmark of a cluster, but it may see it with weight 0.
    trace = hessian[..., 0, 0] + hessian[..., 1, 1] + hessian[..., 2, 2]
    solved = free & (trace > 0)
    one = jnp.eye(3, dtype=hessian.dtype)[None, None]
    return jnp.where(solved[..., None, None], hessian, one), solved
