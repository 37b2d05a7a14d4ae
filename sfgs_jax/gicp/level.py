"""Alignment at one level: the steps, and the exact derivative of where they end."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import se3
from sfgs_jax.gicp.cloud import OrganisedLevel
from sfgs_jax.gicp.config import GicpConfig, at_level
from sfgs_jax.gicp.correspondences import (
    Correspondences,
    Samples,
    Target,
    associate,
    pair,
    samples_of,
    target_of,
)
from sfgs_jax.gicp.normal_equations import point_moments
from sfgs_jax.gicp.point_cloud import PointLevel
from sfgs_jax.gicp.prior import MotionPrior
from sfgs_jax.gicp.step import Equations, equations, newton, solve

THINNING = 2
"""An alignment is judged by rows and columns this many times farther apart than those that it aligns: the
windows of neighbours hold mostly the same pixels."""

Levels = tuple[OrganisedLevel, ...] | tuple[PointLevel, ...]
_Outcome = tuple[jaxlie.SE3, Int[Array, ""], Bool[Array, ""]]


class LevelProblem(eqx.Module):
    """One level of a source and a target.

    Attributes:
        source: the points to align.
        target: what to align them with.
        moments: of the source points, for the normal equations.
        prior: what is known of the motion.
        width: width of the robust kernel at this level; static.
        shared: how many source points share one measurement; static.
        thinned: of how many points to align each is one; static.
        max_iterations: static.
        tolerance: step at which the level is done, metres and radians; static.
        config: static.
    """

    source: Samples
    target: Target
    moments: Float[Array, "10 N"]
    prior: MotionPrior | None
    width: float = eqx.field(static=True)
    shared: float = eqx.field(static=True)
    thinned: int = eqx.field(static=True)
    max_iterations: int = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    config: GicpConfig = eqx.field(static=True)

    def pairs(self, T: jaxlie.SE3) -> Correspondences:
        """Correspondences at a motion."""
        return associate(self.source, self.target, T)[0]

    def equations(self, T: jaxlie.SE3, pairs: Correspondences) -> Equations:
        """Normal equations at a motion."""
        return equations(
            self.source, pairs, self.moments, T, self.prior, self.width, self.shared, self.config
        )

    def minimise(self, T: jaxlie.SE3, skipped: Bool[Array, ""]) -> _Outcome:
        """The motion where the steps become short, how many there were, and whether they did.

        A level that is skipped has done so without a step.
        """
        if self.config.optimizer == "gauss_newton":
            return self._gauss_newton(T, skipped)
        return self._levenberg_marquardt(T, skipped)

    def _step(
        self, T: jaxlie.SE3, e: Equations, damping: Float[Array, ""]
    ) -> tuple[jaxlie.SE3, Bool[Array, ""]]:
        delta = solve(e, damping, self.config.step_observability)
        square = jnp.maximum(jnp.sum(delta[:3] ** 2), jnp.sum(delta[3:] ** 2))
        return se3.compose(T, se3.exp(delta)), square < self.tolerance**2

    def _gauss_newton(self, T: jaxlie.SE3, skipped: Bool[Array, ""]) -> _Outcome:
        damping = jnp.asarray(self.config.damping, self.moments.dtype)

        def unfinished(state: _Outcome) -> Bool[Array, ""]:
            _, iteration, settled = state
            return (iteration < self.max_iterations) & ~settled

        def step(state: _Outcome) -> _Outcome:
            T, iteration, _ = state
            T, settled = self._step(T, self.equations(T, self.pairs(T)), damping)
            return T, iteration + 1, settled

        return lax.while_loop(unfinished, step, (T, jnp.asarray(0), skipped))

    def _levenberg_marquardt(self, T: jaxlie.SE3, skipped: Bool[Array, ""]) -> _Outcome:
        """Steps are tried with correspondences found anew: the cost is of where they lead, not of a model."""
        state = _Trial(
            T,
            self.equations(T, self.pairs(T)),
            jnp.asarray(self.config.damping, self.moments.dtype),
            jnp.asarray(0),
            skipped,
        )

        def unfinished(state: _Trial) -> Bool[Array, ""]:
            return (state.iteration < self.max_iterations) & ~state.settled

        def step(state: _Trial) -> _Trial:
            T, short = self._step(state.T, state.equations, state.damping)
            e = self.equations(T, self.pairs(T))
            # A change of the cost below its rounding is no rise.
            better = e.cost <= state.equations.cost * (1 + 1e-5)
            T, e = jax.tree.map(
                lambda new, old: jnp.where(better, new, old), (T, e), (state.T, state.equations)
            )
            damping = jnp.clip(state.damping * jnp.where(better, 0.1, 10), 1e-6, 1e6)
            return _Trial(T, e, damping, state.iteration + 1, short)

        end = lax.while_loop(unfinished, step, state)
        return end.T, end.iteration, end.settled

    def corrected(self, T: jaxlie.SE3) -> jaxlie.SE3:
        """One Newton step from a motion at which the steps have ended, at fixed correspondences.

        The value is that motion, up to its tolerance; the derivative is that of where the steps end.
        """
        fixed = lax.stop_gradient(self)
        pairs, index = associate(fixed.source, fixed.target, T)

        def equations_at(problem: "LevelProblem", delta: Float[Array, "6"]) -> Equations:
            moved = se3.compose(T, se3.exp(delta))
            found = pair(problem.source, problem.target, moved, index, pairs.found)
            return problem.equations(moved, found)

        def gradients(problem: "LevelProblem", delta: Float[Array, "6"]) -> tuple[Array, Array | None]:
            e = equations_at(problem, delta)
            return e.gradient, None if e.prior is None else e.prior[1]

        zero = jnp.zeros(6, self.moments.dtype)
        slope, prior_slope = jax.jacfwd(lambda delta: gradients(fixed, delta))(zero)
        gradient, prior_gradient = gradients(self, zero)
        exact = eqx.tree_at(
            lambda e: (e.hessian, e.gradient, e.prior),
            equations_at(fixed, zero),
            (slope, gradient, None if prior_gradient is None else (prior_slope, prior_gradient)),
            is_leaf=lambda x: x is None,
        )
        return se3.compose(T, se3.exp(newton(exact, self.config.step_observability)))


class _Trial(eqx.Module):
    """State of Levenberg-Marquardt."""

    T: jaxlie.SE3
    equations: Equations
    damping: Float[Array, ""]
    iteration: Int[Array, ""]
    settled: Bool[Array, ""]


def level_problem(
    source: Levels,
    target: Levels,
    prior: MotionPrior | None,
    index: int,
    config: GicpConfig,
    *,
    judged: bool = False,
) -> LevelProblem:
    """The problem at a level, counted from the finest; a cloud with fewer levels repeats its coarsest.

    With `judged` of an organised source only what an alignment is judged by.
    """
    level = at_level(source, index)
    thinning = THINNING if judged and isinstance(level, OrganisedLevel) else 1
    stride = thinning * stride_of(level, index, config)
    samples = samples_of(level, stride, config)
    return LevelProblem(
        samples,
        target_of(at_level(target, index), index, config),
        point_moments(samples.points),
        prior,
        config.kernel_width * 2**index,
        shared_by(level, stride, config),
        thinning**2,
        at_level(config.max_iterations, index),
        at_level(config.tolerance, index),
        config,
    )


def stride_of(level: OrganisedLevel | PointLevel, index: int, config: GicpConfig) -> int:
    """Every how many rows and columns of a source's level are aligned; small images keep what they have."""
    kept = level.valid.size // at_level(config.min_points, index)
    return max(1, min(at_level(config.strides, index), math.isqrt(kept)))


def shared_by(level: OrganisedLevel | PointLevel, stride: int, config: GicpConfig) -> float:
    """How many points of a source share one measurement: those in the window of a depth image's surface."""
    if isinstance(level, PointLevel):
        return 1.0
    return max(1.0, ((2 * config.radius + 1) / stride) ** 2)
