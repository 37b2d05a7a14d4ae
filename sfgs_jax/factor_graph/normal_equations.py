"""Normal equations of a graph, and their reduction to the poses by the Schur complement."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sfgs_jax.factor_graph.graph import FactorGraph
from sfgs_jax.factor_graph.structure import CLUSTER_LANDMARKS
from sfgs_jax.factor_graph.values import Values


class NormalEquations(eqx.Module):
    """H step = -gradient, in blocks; fixed variables are left out (their blocks are 0, or identity).

    Attributes:
        diagonal: (P, 6, 6) pose blocks; the identity for poses that are fixed or that no factor touches.
        off_diagonal: (B, 6, 6) pose-pose blocks.
        gradient: (P, 6).
        landmark_hessian: (C, m, 3, 3); the identity at unused places.
        landmark_gradient: (C, m, 3).
        cross: (C, m, w, 3, 6) landmark-pose blocks.
        losses: per factor block (N,).
        undetermined: a free variable that no factor touches.
    """

    diagonal: Float[Array, "P 6 6"]
    off_diagonal: Float[Array, "B 6 6"]
    gradient: Float[Array, "P 6"]
    landmark_hessian: Float[Array, "C m 3 3"]
    landmark_gradient: Float[Array, "C m 3"]
    cross: Float[Array, "C m w 3 6"]
    losses: tuple[Float[Array, "..."], ...]
    undetermined: Bool[Array, ""]


class Reduced(eqx.Module):
    """Equations of the poses alone, damped; d is 6 unless only a part of each pose is solved for.

    Attributes:
        diagonal: (P, d, d).
        off_diagonal: (B, d, d).
        right: (P, d), the negative reduced gradient.
    """

    diagonal: Float[Array, "P d d"]
    off_diagonal: Float[Array, "B d d"]
    right: Float[Array, "P d"]


class Eliminated(eqx.Module):
    """What elimination leaves for finding the landmarks once the poses are known.

    Attributes:
        factor: (C, m, 3, 3) lower Cholesky factors of the damped landmark blocks.
        rows: (C, 3 m, 6 w) inverse factor times landmark-pose blocks.
        right: (C, 3 m) inverse factor times negative landmark gradient.
    """

    factor: Float[Array, "C m 3 3"]
    rows: Float[Array, "C r s"]
    right: Float[Array, "C r"]


def linearise(graph: FactorGraph, values: Values) -> NormalEquations:
    """Normal equations at the given values."""
    s, dtype = graph.structure, values.poses.wxyz_xyz.dtype
    P, B = graph.num_poses, s.rows.shape[0]
    C, w = s.cluster_poses.shape
    m = CLUSTER_LANDMARKS
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
    known_or_none = jnp.append(known, False)

    free_landmark = jnp.append(jnp.asarray(graph.free_landmarks), False)[jnp.asarray(s.cluster_landmarks)]
    point = landmarks[:-1].reshape(C, m, 12)
    hessian = point[..., :9].reshape(C, m, 3, 3)
    # A cluster's places are landmarks that a row sees, but it may see them with weight 0.
    trace = hessian[..., 0, 0] + hessian[..., 1, 1] + hessian[..., 2, 2]
    solved = free_landmark & (trace > 0)
    hessian = jnp.where(solved[..., None, None], hessian, jnp.eye(3, dtype=dtype))
    coupled = solved[:, :, None] & known_or_none[jnp.asarray(s.cluster_poses)][:, None]
    count_solved = jnp.sum(solved.astype(jnp.int32))
    wanted = jnp.sum(jnp.asarray(graph.free_landmarks).astype(jnp.int32))
    return NormalEquations(
        diagonal,
        off_diagonal,
        jnp.where(known[:, None], gradient, 0),
        hessian,
        jnp.where(solved[..., None], point[..., 9:], 0),
        jnp.where(coupled[..., None, None], cross[:-1].reshape(C, m, w, 3, 6), 0),
        tuple(losses),
        jnp.any(jnp.asarray(graph.free_poses) & ~known) | (count_solved < wanted),
    )


def add_pose_blocks(
    graph: FactorGraph, i: int, hessian: Float[Array, "M k d k d"], blocks: Float[Array, "S d d"]
) -> Float[Array, "S d d"]:
    """Sums with what the groups of the i-th factor block add to the pose-pose blocks."""
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
    """Sums with what the groups of the i-th factor block add to each pose."""
    groups = jnp.asarray(graph.structure.groups[i]).reshape(-1)
    padded = jnp.concatenate([sums, jnp.zeros_like(sums[:1])])
    return padded.at[groups].add(rows.reshape(len(groups), *sums.shape[1:]))[:-1]


def hold_fixed(
    graph: FactorGraph, blocks: Float[Array, "S d d"]
) -> tuple[Float[Array, "P d d"], Float[Array, "B d d"], Bool[Array, " P"]]:
    """Blocks on and off the diagonal of the poses to solve for, and which these are.

    Poses that are fixed or that no factor touches have the identity, and nothing beside it.
    """
    s, P = graph.structure, graph.num_poses
    diagonal = blocks[:P]
    known = jnp.asarray(graph.free_poses) & jnp.any(jnp.diagonal(diagonal, axis1=1, axis2=2) > 0, axis=1)
    diagonal = jnp.where(known[:, None, None], diagonal, jnp.eye(blocks.shape[1], dtype=blocks.dtype))
    known_or_none = jnp.append(known, False)
    both = known_or_none[jnp.asarray(s.rows)] & known_or_none[jnp.asarray(s.columns)]
    return diagonal, jnp.where(both[:, None, None], blocks[P:-1], 0), known


def reduce(
    graph: FactorGraph, equations: NormalEquations, damping: Float[Array, ""]
) -> tuple[Reduced, Eliminated, Bool[Array, ""]]:
    """Schur complement of the landmarks, with `damping` times the diagonal of H added to H.

    Returns the poses' equations, what is needed to find the landmarks, and whether a landmark's block was
    not positive definite (it is then made so).
    """
    s = graph.structure
    damped = damp(equations.landmark_hessian, damping)
    factor, deficient = _cholesky3(damped)
    C, m, w = equations.cross.shape[:3]
    forward = _forward(factor, jnp.moveaxis(equations.cross, 3, 0))
    rows = jnp.transpose(forward, (1, 2, 0, 3, 4)).reshape(C, m * 3, w * 6)
    right = jnp.moveaxis(_forward(factor, -jnp.moveaxis(equations.landmark_gradient, 2, 0)), 0, 2)
    right = right.reshape(C, m * 3)
    eliminated = Eliminated(factor, rows, right)
    diagonal, off_diagonal, reduced_right = (
        damp(equations.diagonal, damping),
        equations.off_diagonal,
        -equations.gradient,
    )
    if C:
        P, B = graph.num_poses, s.rows.shape[0]
        product = jnp.einsum("cri,crj->cij", rows, rows).reshape(C, w, 6, w, 6)
        flat = jnp.transpose(product, (0, 1, 3, 2, 4)).reshape(-1, 36)
        sums = jax.ops.segment_sum(flat, jnp.asarray(s.cluster_slots).reshape(-1), P + B + 1)
        diagonal = diagonal - sums[:P].reshape(-1, 6, 6)
        off_diagonal = off_diagonal - sums[P : P + B].reshape(-1, 6, 6)
        pull = jnp.einsum("cri,cr->ci", rows, right).reshape(-1, 6)
        reduced_right -= jax.ops.segment_sum(pull, jnp.asarray(s.cluster_poses).reshape(-1), P + 1)[:P]
    return Reduced(diagonal, off_diagonal, reduced_right), eliminated, jnp.any(deficient)


def landmark_steps(
    graph: FactorGraph, eliminated: Eliminated, pose_steps: Float[Array, "P 6"]
) -> Float[Array, "L 3"]:
    """Steps of the landmarks, given those of the poses."""
    s, L = graph.structure, graph.num_landmarks
    C, m = eliminated.factor.shape[:2]
    if C == 0:
        return jnp.zeros((L, 3), pose_steps.dtype)
    padded = jnp.concatenate([pose_steps, jnp.zeros_like(pose_steps[:1])])
    seen = padded[jnp.asarray(s.cluster_poses)].reshape(C, -1)
    right = eliminated.right - jnp.einsum("cri,ci->cr", eliminated.rows, seen)
    steps = _backward(eliminated.factor, right.reshape(C, m, 3)).reshape(-1, 3)
    places = jnp.asarray(s.cluster_landmarks).reshape(-1)
    return jnp.zeros((L + 1, 3), steps.dtype).at[places].set(steps)[:L]


def damp(blocks: Float[Array, "*b n n"], damping: Float[Array, ""]) -> Float[Array, "*b n n"]:
    """Blocks with (1 + damping) times their diagonal."""
    n = blocks.shape[-1]
    return blocks * (1 + damping * jnp.eye(n, dtype=blocks.dtype))


def _cholesky3(
    blocks: Float[Array, "*b 3 3"],
) -> tuple[Float[Array, "*b 3 3"], Bool[Array, "*b"]]:
    """Lower Cholesky factors in closed form; pivots have a floor relative to their diagonal entry."""
    floor = 10 * jnp.finfo(blocks.dtype).eps
    deficient = jnp.zeros(blocks.shape[:-2], bool)
    zero = jnp.zeros(blocks.shape[:-2], blocks.dtype)
    L = [[zero] * 3 for _ in range(3)]
    for j in range(3):
        entry = blocks[..., j, j]
        least = jnp.maximum(floor * entry, jnp.finfo(blocks.dtype).tiny)
        pivot = entry - sum((L[j][k] ** 2 for k in range(j)), zero)
        deficient |= pivot < least
        L[j][j] = jnp.sqrt(jnp.maximum(pivot, least))
        for i in range(j + 1, 3):
            L[i][j] = (blocks[..., i, j] - sum((L[i][k] * L[j][k] for k in range(j)), zero)) / L[j][j]
    return jnp.stack([jnp.stack(row, axis=-1) for row in L], axis=-2), deficient


def _forward(factor: Float[Array, "C m 3 3"], right: Float[Array, "3 C m *n"]) -> Float[Array, "3 C m *n"]:
    """Inverse factor times right-hand sides."""
    extra = [1] * (right.ndim - 3)
    entry = [[factor[..., i, j].reshape(*factor.shape[:2], *extra) for j in range(3)] for i in range(3)]
    x = right[0] / entry[0][0]
    y = (right[1] - entry[1][0] * x) / entry[1][1]
    z = (right[2] - entry[2][0] * x - entry[2][1] * y) / entry[2][2]
    return jnp.stack([x, y, z])


def _backward(factor: Float[Array, "C m 3 3"], right: Float[Array, "C m 3"]) -> Float[Array, "C m 3"]:
    """Inverse transposed factor times right-hand sides."""
    z = right[..., 2] / factor[..., 2, 2]
    y = (right[..., 1] - factor[..., 2, 1] * z) / factor[..., 1, 1]
    x = (right[..., 0] - factor[..., 1, 0] * y - factor[..., 2, 0] * z) / factor[..., 0, 0]
    return jnp.stack([x, y, z], axis=-1)
