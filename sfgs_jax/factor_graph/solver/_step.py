"""One step: the solution of the damped normal equations, and the drop of the cost in the linear model."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from sfgs_jax.factor_graph.problem._graph import FactorGraph
from sfgs_jax.factor_graph.solver._config import SolverConfig
from sfgs_jax.factor_graph.solver._linear_solvers import prepare_solve
from sfgs_jax.factor_graph.solver._normal_equations import NormalEquations
from sfgs_jax.factor_graph.solver._schur_complement import landmark_steps, schur_complement


class Step(eqx.Module):
    """A step and its drop of the cost in the linear model.

    Attributes:
        poses: (P, 6) tangents.
        landmarks: (L, 3) metres.
        expected: drop of the cost in the linear model.
        slope: drop of the cost per share of the step, at its beginning.
        finite: whether the system could be solved.
        deficient: whether a landmark's block had no unique solution.
    """

    poses: Float[Array, "P 6"]
    landmarks: Float[Array, "L 3"]
    expected: Float[Array, ""]
    slope: Float[Array, ""]
    finite: Bool[Array, ""]
    deficient: Bool[Array, ""]


def compute_step(
    graph: FactorGraph, equations: NormalEquations, damping: Float[Array, ""], config: SolverConfig
) -> Step:
    """Solution of the damped normal equations.

    Args:
        graph: structure and linear solver.
        equations: normal equations of the graph.
        damping: share of the diagonal to add.
        config: limits of conjugate gradients.
    """
    system, eliminated, deficient = schur_complement(graph, equations, damping)
    solve = prepare_solve(
        graph,
        system,
        pcg_tolerance=config.pcg_tolerance,
        pcg_max_iterations=config.pcg_max_iterations,
    )
    poses = solve(system.right)
    landmarks = landmark_steps(graph, eliminated, poses)
    finite = jnp.all(jnp.isfinite(poses)) & jnp.all(jnp.isfinite(landmarks))
    poses, landmarks = jnp.where(finite, poses, 0), jnp.where(finite, landmarks, 0)
    # With (H + damping D) step = -g the model drops by (damping step D step - g step) / 2.
    diagonal = jnp.diagonal(equations.diagonal, axis1=1, axis2=2)
    resisted = jnp.sum(damping * diagonal * poses**2)
    slope = -jnp.sum(poses * equations.gradient)
    point_diagonal = jnp.diagonal(equations.landmark_hessian, axis1=2, axis2=3)
    padded = jnp.concatenate([landmarks, jnp.zeros((1, 3), landmarks.dtype)])
    points = padded[jnp.asarray(graph.structure.cluster_landmarks)]
    resisted += jnp.sum(damping * point_diagonal * points**2)
    slope -= jnp.sum(points * equations.landmark_gradient)
    return Step(
        poses=poses,
        landmarks=landmarks,
        expected=(resisted + slope) / 2,
        slope=slope,
        finite=finite,
        deficient=deficient,
    )
