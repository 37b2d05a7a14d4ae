"""Implicit differentiation of an optimum, by jaxopt; the only file that uses it."""

import warnings
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.factor_graph._values import Values, retract
from sfgs_jax.factor_graph.problem._graph import FactorGraph
from sfgs_jax.factor_graph.solver._config import SolverConfig
from sfgs_jax.factor_graph.solver._cost import cost
from sfgs_jax.factor_graph.solver._levenberg_marquardt import solve
from sfgs_jax.factor_graph.solver._linear_solvers import prepare_solve
from sfgs_jax.factor_graph.solver._normal_equations import NormalEquations, build_normal_equations
from sfgs_jax.factor_graph.solver._schur_complement import landmark_steps, schur_complement

_Steps = tuple[Float[Array, "P 6"], Float[Array, "L 3"]]


@checked
def solve_implicit(graph: FactorGraph, values: Values, config: SolverConfig | None = None) -> Values:
    """Optimum of a graph, with gradients by every floating array in the graph.

    The values are those of `solve`. They are differentiated as the root of the cost's gradient (Blondel et
    al., Efficient and modular implicit differentiation, 2022), with the exact Hessian. Conjugate gradients
    solve with it, preconditioned by the Gauss-Newton factorisation.

    The derivative holds at an optimum that the factors determine, so solve to convergence. It does not depend
    on the start, whose gradient is 0. It may be called within `jax.jit`, as `solve`. Use `solve` if you need
    the status, or no gradient.

    Args:
        graph: factors and structure; measurements, weights and parameters may be traced and differentiated.
        values: poses and landmarks to start from.
        config: settings, `SolverConfig()` if not given; static under `jit`.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    floating, rest = eqx.partition(graph, eqx.is_inexact_array)
    return _optimum(floating, rest, values, config)


@eqx.filter_custom_vjp
def _optimum(floating: Any, rest: Any, values: Values, config: SolverConfig | None) -> Values:
    return solve(eqx.combine(floating, rest), values, config).values


@_optimum.def_fwd
def _forward(
    _perturbed: Any, floating: Any, rest: Any, values: Values, config: SolverConfig | None
) -> tuple[Values, Values]:
    optimum = _optimum(floating, rest, values, config)
    return optimum, optimum


@_optimum.def_bwd
def _backward(optimum: Values, cotangent: Values, _perturbed: Any, floating: Any, rest: Any, *_: Any) -> Any:
    graph = eqx.combine(floating, rest)

    def slope(steps: _Steps, floating: Any) -> _Steps:
        current = eqx.combine(floating, rest)

        def moved_cost(steps: _Steps) -> Array:
            return cost(current, retract(optimum, *_keep_free(current, steps)))

        gradient = jax.grad(moved_cost)(steps)
        # The equation of a fixed variable says that its step is 0.
        held = jax.tree.map(jnp.subtract, steps, _keep_free(current, steps))
        return jax.tree.map(jnp.add, gradient, held)

    def linear_solve(matvec: Callable[[_Steps], _Steps], right: _Steps) -> _Steps:
        precondition = _gauss_newton_inverse(graph, build_normal_equations(graph, optimum))
        tolerance = 16 * float(jnp.finfo(optimum.landmarks.dtype).eps)
        solution, _ = jax.scipy.sparse.linalg.cg(matvec, right, M=precondition, tol=tolerance, maxiter=50)
        return solution

    still = jnp.zeros((graph.num_poses, 6), optimum.poses.wxyz_xyz.dtype), jnp.zeros_like(optimum.landmarks)
    given = jax.tree.map(
        lambda value, change: jnp.zeros_like(value) if change is None else change,
        optimum,
        cotangent,
        is_leaf=lambda leaf: leaf is None,
    )
    (pulled,) = jax.vjp(lambda steps: retract(optimum, *steps), still)[1](given)
    (change,) = _root_vjp()(slope, still, (floating,), pulled, solve=linear_solve)
    return change


def _root_vjp() -> Callable[..., Any]:
    """The function of jaxopt, imported here: it warns on import that its development has ended."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from jaxopt.implicit_diff import root_vjp
    return root_vjp


def _keep_free(graph: FactorGraph, steps: _Steps) -> _Steps:
    """Steps with zeros for fixed variables."""
    poses, landmarks = steps
    return (
        jnp.where(jnp.asarray(graph.free_poses)[:, None], poses, 0),
        jnp.where(jnp.asarray(graph.free_landmarks)[:, None], landmarks, 0),
    )


def _gauss_newton_inverse(graph: FactorGraph, equations: NormalEquations) -> Callable[[_Steps], _Steps]:
    """Inverse of the Gauss-Newton Hessian, slightly damped; the identity for fixed variables."""
    damping = jnp.asarray(1e-6, equations.gradient.dtype)
    reduced, _, _ = schur_complement(graph, equations, damping)
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
        reduced, eliminated, _ = schur_complement(graph, pushed, damping)
        steps = linear_solve(reduced.right)
        points = landmark_steps(graph, eliminated, steps)
        kept = _keep_free(graph, (steps, points))
        free_landmark = jnp.asarray(graph.free_landmarks) & solved
        return (
            jnp.where(jnp.asarray(graph.free_poses)[:, None], kept[0], poses),
            jnp.where(free_landmark[:, None], kept[1], landmarks),
        )

    return apply
