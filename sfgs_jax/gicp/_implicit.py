"""Derivative of the aligned motion, by the implicit function theorem.

At the minimum the gradient of the normal equations with fixed correspondences vanishes: g(T, clouds) = 0. So
T moves with the clouds by -(dg/dT)^-1 dg/dclouds. One Newton step with the exact dg/dT, at the
correspondences found there, has that derivative.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3
from sfgs_jax.gicp._correspondences import associate, correspondences_of_rows
from sfgs_jax.gicp._level_problem import LevelProblem
from sfgs_jax.gicp._normal_equations import NormalEquations, newton_step


def newton_corrected(problem: LevelProblem, T_target_source: jaxlie.SE3) -> jaxlie.SE3:
    """Motion after one Newton step from a minimum, at fixed correspondences.

    Its value is the minimum, up to the tolerance of the steps; its derivative is the minimum's. Rows of a
    source that was read with a motion move with the motion sought, here as in the steps.

    Args:
        problem: the finest level, with its points as they were read.
        T_target_source: minimum of the problem; a constant for the derivative.
    """
    fixed = lax.stop_gradient(problem)
    pairs, index = associate(fixed.at(T_target_source).source, fixed.target, T_target_source)

    def equations_at(problem: LevelProblem, delta: Float[Array, "6"]) -> NormalEquations:
        moved = se3.compose(T_target_source, se3.exp(delta))
        now = problem.at(moved)
        found = correspondences_of_rows(now.source, now.target, moved, index, pairs.valid)
        return now.equations(moved, found)

    def gradients(problem: LevelProblem, delta: Float[Array, "6"]) -> tuple[Array, Array | None]:
        equations = equations_at(problem, delta)
        return equations.gradient, None if equations.prior is None else equations.prior[1]

    zero = jnp.zeros(6, problem.moments.dtype)
    hessian, prior_hessian = jax.jacfwd(lambda delta: gradients(fixed, delta))(zero)
    gradient, prior_gradient = gradients(problem, zero)
    exact = eqx.tree_at(
        lambda e: (e.hessian, e.gradient, e.prior),
        equations_at(fixed, zero),
        (hessian, gradient, None if prior_gradient is None else (prior_hessian, prior_gradient)),
        is_leaf=lambda x: x is None,
    )
    return se3.compose(T_target_source, se3.exp(newton_step(exact, problem.config.step_observability)))
