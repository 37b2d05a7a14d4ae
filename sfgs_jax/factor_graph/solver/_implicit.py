"""Implicit differentiation of an optimum, by jaxopt; the only file that uses it."""

import warnings
from collections.abc import Callable
from functools import partial
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.flatten_util import ravel_pytree
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
_Product = Callable[[Float[Array, " n"]], Float[Array, " n"]]
_Tree = TypeVar("_Tree")


@checked
def solve_implicit(graph: FactorGraph, values: Values, config: SolverConfig | None = None) -> Values:
    """Optimum of a graph, differentiable by every floating array in the graph.

    The values are those of `solve`, with the derivatives of `differentiable_optimum`. It may be called within
    `jax.jit`, as `solve`. Use `solve` if you need the status, or no derivative.

    Args:
        graph: factors and structure; measurements, weights and parameters may be traced and differentiated.
        values: poses and landmarks to start from. The optimum does not depend on them: their derivative is 0.
        config: settings, `SolverConfig()` if not given; static under `jit`.

    Raises:
        InputError: numbers of poses or landmarks that don't match the graph's.
    """
    return differentiable_optimum(graph, solve(_constant(graph), _constant(values), config).values)


@checked
def differentiable_optimum(graph: FactorGraph, optimum: Values) -> Values:
    """An optimum with its derivatives by every floating array in the graph, in forward and reverse mode.

    They are those of the root of the cost's gradient (Blondel et al., Efficient and modular implicit
    differentiation, 2022), with the exact Hessian. Conjugate gradients solve with it, preconditioned by the
    Gauss-Newton factorisation.

    They hold at an optimum that the factors determine, so solve to convergence. It costs nothing where no
    derivative is asked for.

    Args:
        graph: factors and structure.
        optimum: its optimum, from `solve`; a constant for the derivative.
    """
    return _differentiable(graph, _constant(optimum))


def _constant(tree: _Tree) -> _Tree:
    return jax.tree.map(lambda x: lax.stop_gradient(x) if eqx.is_inexact_array(x) else x, tree)


@eqx.filter_custom_jvp
def _differentiable(graph: FactorGraph, optimum: Values) -> Values:
    return optimum


@_differentiable.def_jvp
def _differentiable_jvp(
    primals: tuple[FactorGraph, Values], tangents: tuple[Any, Any]
) -> tuple[Values, Values]:
    graph, optimum = primals
    floating, rest = eqx.partition(graph, eqx.is_inexact_array)

    def rate_of(x: Array | None, rate: Array | None) -> Array | None:
        return jnp.zeros_like(x) if rate is None and x is not None else rate

    rates = jax.tree.map(rate_of, floating, tangents[0], is_leaf=lambda x: x is None)

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
        # The transpose needs all of the right side to be differentiated, or nothing: so it is one vector.
        flat, steps_of = ravel_pytree(right)

        def conjugate_gradients(product: _Product, right: Float[Array, " n"]) -> Float[Array, " n"]:
            inverse = partial(_flattened, precondition, steps_of)
            return jax.scipy.sparse.linalg.cg(product, right, M=inverse, tol=tolerance, maxiter=50)[0]

        # The Hessian is symmetric, so that the reverse mode solves with it too.
        product = partial(_flattened, matvec, steps_of)
        return steps_of(lax.custom_linear_solve(product, flat, conjugate_gradients, symmetric=True))

    still = jnp.zeros((graph.num_poses, 6), optimum.poses.wxyz_xyz.dtype), jnp.zeros_like(optimum.landmarks)
    steps = _root_jvp()(slope, still, (floating,), (rates,), solve=linear_solve)
    return jax.jvp(lambda steps: retract(optimum, *steps), (still,), (steps,))


def _flattened(
    function: Callable[[_Steps], _Steps], steps_of: Callable[[Array], _Steps], vector: Float[Array, " n"]
) -> Float[Array, " n"]:
    return ravel_pytree(function(steps_of(vector)))[0]


def _root_jvp() -> Callable[..., Any]:
    """The function of jaxopt, imported here: it warns on import that its development has ended."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        from jaxopt.implicit_diff import root_jvp
    return root_jvp


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
