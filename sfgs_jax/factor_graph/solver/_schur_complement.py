"""Schur complement: the landmarks eliminated from the damped normal equations, and found again afterwards."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import Precision
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import back_substitution, cholesky, forward_substitution
from sfgs_jax.factor_graph.problem._graph import FactorGraph
from sfgs_jax.factor_graph.solver._normal_equations import NormalEquations


class ReducedSystem(eqx.Module):
    """Damped equations of the poses alone; d is 6 unless only a part of each pose is solved for.

    Attributes:
        diagonal: (P, d, d).
        off_diagonal: (B, d, d).
        right: (P, d), the negative reduced gradient.
    """

    diagonal: Float[Array, "P d d"]
    off_diagonal: Float[Array, "B d d"]
    right: Float[Array, "P d"]


class Eliminated(eqx.Module):
    """Eliminated landmarks: the equations that give them once the poses are known.

    Attributes:
        factor: (C, m, 3, 3) lower Cholesky factors of the damped landmark blocks.
        rows: (C, 3 m, 6 w) inverse factor times landmark-pose blocks.
        right: (C, 3 m) inverse factor times negative landmark gradient.
    """

    factor: Float[Array, "C m 3 3"]
    rows: Float[Array, "C r s"]
    right: Float[Array, "C r"]


def schur_complement(
    graph: FactorGraph, equations: NormalEquations, damping: Float[Array, ""]
) -> tuple[ReducedSystem, Eliminated, Bool[Array, ""]]:
    """Schur complement of the landmarks, with `damping` times the diagonal of H added to H.

    Args:
        graph: structure.
        equations: normal equations.
        damping: share of the diagonal to add.

    Returns:
        The poses' equations, the eliminated landmarks, and whether some landmark's block was deficient: not
        positive definite, and then made so.
    """
    s = graph.structure
    factor, deficient = cholesky(damp_diagonal(equations.landmark_hessian, damping))
    C, m, w = equations.cross.shape[:3]
    forward = forward_substitution(factor, jnp.moveaxis(equations.cross, 3, 0))
    rows = jnp.transpose(forward, (1, 2, 0, 3, 4)).reshape(C, m * 3, w * 6)
    right = jnp.moveaxis(forward_substitution(factor, -jnp.moveaxis(equations.landmark_gradient, 2, 0)), 0, 2)
    right = right.reshape(C, m * 3)
    diagonal, off_diagonal = damp_diagonal(equations.diagonal, damping), equations.off_diagonal
    reduced_right = -equations.gradient
    if C:
        P, B = graph.num_poses, s.rows.shape[0]
        product = jnp.einsum("cri,crj->cij", rows, rows, precision=Precision.HIGHEST)
        flat = jnp.transpose(product.reshape(C, w, 6, w, 6), (0, 1, 3, 2, 4)).reshape(-1, 36)
        sums = jax.ops.segment_sum(flat, jnp.asarray(s.cluster_slots).reshape(-1), P + B + 1)
        diagonal = diagonal - sums[:P].reshape(-1, 6, 6)
        off_diagonal = off_diagonal - sums[P : P + B].reshape(-1, 6, 6)
        pull = jnp.einsum("cri,cr->ci", rows, right, precision=Precision.HIGHEST).reshape(-1, 6)
        reduced_right -= jax.ops.segment_sum(pull, jnp.asarray(s.cluster_poses).reshape(-1), P + 1)[:P]
    system = ReducedSystem(diagonal, off_diagonal, reduced_right)
    return system, Eliminated(factor, rows, right), jnp.any(deficient)


def landmark_steps(
    graph: FactorGraph, eliminated: Eliminated, pose_steps: Float[Array, "P 6"]
) -> Float[Array, "L 3"]:
    """Steps of the landmarks, by back substitution of the poses' steps.

    Args:
        graph: structure.
        eliminated: eliminated landmarks.
        pose_steps: (P, 6) solution of the reduced system.
    """
    s, L = graph.structure, graph.num_landmarks
    C, m = eliminated.factor.shape[:2]
    if C == 0:
        return jnp.zeros((L, 3), pose_steps.dtype)
    padded = jnp.concatenate([pose_steps, jnp.zeros_like(pose_steps[:1])])
    seen = padded[jnp.asarray(s.cluster_poses)].reshape(C, -1)
    known = jnp.einsum("cri,ci->cr", eliminated.rows, seen, precision=Precision.HIGHEST)
    right = eliminated.right - known
    steps = back_substitution(eliminated.factor, right.reshape(C, m, 3)).reshape(-1, 3)
    places = jnp.asarray(s.cluster_landmarks).reshape(-1)
    return jnp.zeros((L + 1, 3), steps.dtype).at[places].set(steps)[:L]


def damp_diagonal(blocks: Float[Array, "*b n n"], damping: Float[Array, ""]) -> Float[Array, "*b n n"]:
    """Blocks with (1 + damping) times their diagonal.

    Args:
        blocks: any number of n x n blocks.
        damping: share of the diagonal to add.
    """
    n = blocks.shape[-1]
    scale = 1 + damping * jnp.eye(n, dtype=blocks.dtype)
    return blocks * jnp.broadcast_to(scale, blocks.shape)
