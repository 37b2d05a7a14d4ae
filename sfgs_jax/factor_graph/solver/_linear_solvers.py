"""Linear solvers of the reduced system: dense Cholesky, multifrontal Cholesky, conjugate gradients."""

from collections.abc import Callable
from functools import partial
from typing import assert_never

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.factor_graph.problem._graph import FactorGraph
from sfgs_jax.factor_graph.solver._multifrontal import multifrontal_cholesky, multifrontal_solve
from sfgs_jax.factor_graph.solver._schur_complement import ReducedSystem

Solve = Callable[[Float[Array, "P d"]], Float[Array, "P d"]]
_PcgState = tuple[Array, Array, Array, Float[Array, ""], Int[Array, ""]]


def prepare_solve(
    graph: FactorGraph, system: ReducedSystem, *, pcg_tolerance: float, pcg_max_iterations: int
) -> Solve:
    """Factorise a system, or prepare its preconditioner, for any number of right-hand sides.

    Rows and columns are first scaled to a unit diagonal. float32 needs it: entries differ by orders of
    magnitude between translations and rotations, and between poses with many observations and with few.

    Args:
        graph: structure and linear solver.
        system: equations; their right-hand side is not used.
        pcg_tolerance: share of the first preconditioned residual at which conjugate gradients stop.
        pcg_max_iterations: most products with the matrix that conjugate gradients take.

    Returns:
        A function that solves for a right-hand side. Its result is not finite if the matrix is not positive
        definite.
    """
    diagonal = jnp.diagonal(system.diagonal, axis1=1, axis2=2)
    scale = lax.rsqrt(jnp.where(diagonal > 0, diagonal, jnp.nan))
    padded = jnp.concatenate([scale, jnp.zeros_like(scale[:1])])
    s = graph.structure
    rows, columns = jnp.asarray(s.rows), jnp.asarray(s.columns)
    scaled = ReducedSystem(
        system.diagonal * scale[:, :, None] * scale[:, None],
        system.off_diagonal * padded[rows][:, :, None] * padded[columns][:, None],
        system.right,
    )
    match graph.linear_solver:
        case "dense":
            solve = _dense(graph, scaled)
        case "sparse":
            assert graph.plan is not None
            plan = graph.plan
            fronts = multifrontal_cholesky(plan, scaled.diagonal, scaled.off_diagonal)
            solve = lambda right: multifrontal_solve(plan, fronts, right)  # noqa: E731
        case "pcg":
            solve = _pcg(graph, scaled, pcg_tolerance, pcg_max_iterations)
        case _:
            assert_never(graph.linear_solver)
    return lambda right: scale * solve(scale * right)


def dense_matrix(graph: FactorGraph, system: ReducedSystem) -> Float[Array, "n n"]:
    """The symmetric d P x d P matrix of a system.

    Args:
        graph: structure.
        system: its blocks.
    """
    s, P, d = graph.structure, graph.num_poses, system.diagonal.shape[1]
    rows, columns = jnp.asarray(s.rows), jnp.asarray(s.columns)
    blocks = jnp.zeros((P * P + 1, d * d), system.diagonal.dtype)
    poses = jnp.arange(P) * (P + 1)
    blocks = blocks.at[poses].set(system.diagonal.reshape(-1, d * d))
    used = rows < P
    lower = jnp.where(used, columns * P + rows, P * P)
    blocks = blocks.at[lower].set(jnp.swapaxes(system.off_diagonal, 1, 2).reshape(-1, d * d))
    upper = jnp.where(used, rows * P + columns, P * P)
    blocks = blocks.at[upper].set(system.off_diagonal.reshape(-1, d * d))
    return jnp.transpose(blocks[:-1].reshape(P, P, d, d), (0, 2, 1, 3)).reshape(d * P, d * P)


def _dense(graph: FactorGraph, system: ReducedSystem) -> Solve:
    """Cholesky factorisation of the leading part of the matrix that holds all free poses.

    The rest of the matrix is an identity. A graph has room to grow, and most of a full factorisation would go
    to poses that are not there yet.
    """
    P, d = system.diagonal.shape[:2]
    parts = sorted({-(-P // divisor) for divisor in (8, 4, 2, 1)})
    last = jnp.max(jnp.where(jnp.asarray(graph.free_poses), jnp.arange(1, P + 1), 0))
    part = jnp.searchsorted(jnp.asarray(parts), last)

    def factorise(poses: int, matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
        size = d * poses
        lower = lax.linalg.cholesky(matrix[:size, :size], symmetrize_input=False)
        return matrix.at[:size, :size].set(lower)

    def substitute(poses: int, lower: Float[Array, "n n"], right: Float[Array, "n 1"]) -> Float[Array, "n 1"]:
        size = d * poses
        leading = lower[:size, :size]
        half = lax.linalg.triangular_solve(leading, right[:size], left_side=True, lower=True)
        whole = lax.linalg.triangular_solve(leading, half, left_side=True, lower=True, transpose_a=True)
        return right.at[:size].set(whole)

    lower = lax.switch(part, [partial(factorise, poses) for poses in parts], dense_matrix(graph, system))

    def solve(right: Float[Array, "P d"]) -> Float[Array, "P d"]:
        column = right.reshape(-1, 1)
        return lax.switch(part, [partial(substitute, poses) for poses in parts], lower, column).reshape(
            right.shape
        )

    return solve


def _matrix_vector_product(
    graph: FactorGraph, system: ReducedSystem, vector: Float[Array, "P d"]
) -> Float[Array, "P d"]:
    """The system's matrix times a vector, block by block."""
    s, P = graph.structure, graph.num_poses
    rows, columns = jnp.asarray(s.rows), jnp.asarray(s.columns)
    padded = jnp.concatenate([vector, jnp.zeros_like(vector[:1])])
    right = jnp.sum(system.off_diagonal * padded[columns][:, None], axis=2)
    left = jnp.sum(system.off_diagonal * padded[rows][:, :, None], axis=1)
    product = jnp.sum(system.diagonal * vector[:, None], axis=2)
    sums = jnp.zeros_like(padded).at[rows].add(right).at[columns].add(left)
    return product + sums[:P]


def _pcg(graph: FactorGraph, system: ReducedSystem, tolerance: float, max_iterations: int) -> Solve:
    """Conjugate gradients with a block-Jacobi preconditioner."""
    inverse = jnp.linalg.inv(system.diagonal)

    def precondition(vector: Float[Array, "P d"]) -> Float[Array, "P d"]:
        return jnp.sum(inverse * vector[:, None], axis=2)

    def dot(a: Array, b: Array) -> Array:
        return jnp.sum(a * b)

    def solve(right: Float[Array, "P d"]) -> Float[Array, "P d"]:
        start = precondition(right)
        target = tolerance**2 * dot(right, start)

        def unfinished(state: _PcgState) -> Bool[Array, ""]:
            _, _, _, square, iteration = state
            return (square > target) & (iteration < max_iterations)

        def step(state: _PcgState) -> _PcgState:
            x, residual, direction, square, iteration = state
            product = _matrix_vector_product(graph, system, direction)
            curvature = dot(direction, product)
            # A matrix that is not positive definite must not pass for solved.
            length = jnp.where(curvature > 0, square / jnp.where(curvature > 0, curvature, 1), jnp.nan)
            x, residual = x + length * direction, residual - length * product
            better = precondition(residual)
            following = dot(residual, better)
            return x, residual, better + following / square * direction, following, iteration + 1

        state = (jnp.zeros_like(right), right, start, dot(right, start), jnp.asarray(0))
        return lax.while_loop(unfinished, step, state)[0]

    return solve
