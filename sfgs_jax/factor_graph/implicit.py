"""Gradients of an optimum by the implicit function theorem; the only file that uses jaxopt."""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.factor_graph.config import SolverConfig
from sfgs_jax.factor_graph.graph import FactorGraph
from sfgs_jax.factor_graph.linear_solvers import prepare_solve
from sfgs_jax.factor_graph.normal_equations import NormalEquations, landmark_steps, linearise, reduce
from sfgs_jax.factor_graph.optimise import cost, solve
from sfgs_jax.factor_graph.values import Values, retract

with warnings.catch_warnings():
    # It says on import that it is no longer developed, which is why it is used in one place only.
    warnings.simplefilter("ignore", DeprecationWarning)
    from jaxopt.implicit_diff import custom_root

_Steps = tuple[Float[Array, "P 6"], Float[Array, "L 3"]]


def solve_implicit(graph: FactorGraph, values: Values, config: SolverConfig | None = None) -> Values:
    """Optimum of a graph, with gradients with respect to every floating array in the graph.

    The values are those of `solve`. Their derivative is that of the root of the cost's gradient (Blondel et
    al., Efficient and modular implicit differentiation, 2022), with the exact Hessian: conjugate gradients
    on its products, preconditioned by the Gauss-Newton factorisation. It holds at an optimum, so solve to
    convergence; it does not depend on the start, whose gradient is 0.

    Args:
        graph: measurements, weights and parameters may be traced and differentiated; indices are fixed.
        values: where to start.
        config: settings of the solve.
    """
    floating, rest = eqx.partition(graph, eqx.is_inexact_array)
    optimum = jax.lax.stop_gradient(
        solve(
            eqx.combine(jax.lax.stop_gradient(floating), rest), jax.lax.stop_gradient(values), config
        ).values
    )

    def slope(steps: _Steps, floating: Any) -> _Steps:
        current = eqx.combine(floating, rest)

        def moved_cost(steps: _Steps) -> Array:
            free = _keep_free(current, steps)
            return cost(current, retract(optimum, *free))

        gradient = jax.grad(moved_cost)(steps)
        # A fixed variable's equation is that its step is 0.
        held = jax.tree.map(jnp.subtract, steps, _keep_free(current, steps))
        return jax.tree.map(jnp.add, gradient, held)

    def linear_solve(matvec: Callable[[_Steps], _Steps], right: _Steps) -> _Steps:
        frozen = eqx.combine(jax.lax.stop_gradient(floating), rest)
        precondition = _gauss_newton(frozen, linearise(frozen, optimum))
        solution, _ = jax.scipy.sparse.linalg.cg(matvec, right, M=precondition, tol=1e-6, maxiter=50)
        return solution

    @custom_root(slope, solve=linear_solve)
    def root(start: _Steps, floating: Any) -> _Steps:
        return start

    zero = jnp.zeros((graph.num_poses, 6), optimum.poses.wxyz_xyz.dtype), jnp.zeros_like(optimum.landmarks)
    return retract(optimum, *root(zero, floating))


def _keep_free(graph: FactorGraph, steps: _Steps) -> _Steps:
    poses, landmarks = steps
    return (
        jnp.where(jnp.asarray(graph.free_poses)[:, None], poses, 0),
        jnp.where(jnp.asarray(graph.free_landmarks)[:, None], landmarks, 0),
    )


def _gauss_newton(graph: FactorGraph, equations: NormalEquations) -> Callable[[_Steps], _Steps]:
    """Inverse of the Gauss-Newton Hessian, slightly damped; the identity on what is fixed."""
    damping = jnp.asarray(1e-6, equations.gradient.dtype)
    reduced, _, _ = reduce(graph, equations, damping)
    linear_solve = prepare_solve(graph, reduced, pcg_tolerance=1e-4, pcg_max_iterations=500)
    places = jnp.asarray(graph.structure.cluster_landmarks)
    solved = jnp.zeros(graph.num_landmarks + 1, bool).at[places.reshape(-1)].set(True)[:-1]

    def apply(right: _Steps) -> _Steps:
        poses, landmarks = right
        padded = jnp.concatenate([landmarks, jnp.zeros((1, 3), landmarks.dtype)])
        free_poses, _ = _keep_free(graph, right)
        pushed = eqx.tree_at(
            lambda e: (e.gradient, e.landmark_gradient), equations, (-free_poses, -padded[places])
        )
        reduced, eliminated, _ = reduce(graph, pushed, damping)
        steps = linear_solve(reduced.right)
        points = landmark_steps(graph, eliminated, steps)
        kept = _keep_free(graph, (steps, points))
        free_landmark = jnp.asarray(graph.free_landmarks) & solved
        return (
            jnp.where(jnp.asarray(graph.free_poses)[:, None], kept[0], poses),
            jnp.where(free_landmark[:, None], kept[1], landmarks),
        )

    return apply
