"""One level of an alignment: its normal equations at a motion, and the steps to the minimum."""

import math
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked, dot
from sfgs_jax.geometry import kernel_rho, kernel_weight, se3
from sfgs_jax.gicp._config import GicpConfig, at_level
from sfgs_jax.gicp._correspondences import (
    Correspondences,
    SourcePoints,
    TargetSurface,
    associate,
    source_points,
    target_surface,
    with_moving_rows,
)
from sfgs_jax.gicp._distance_noise import DistanceNoise
from sfgs_jax.gicp._normal_equations import (
    MotionPrior,
    NormalEquations,
    covariance_weight_matrices,
    damped_step,
    gradient,
    hessian,
    isotropic_hessian,
    moment_sums,
    point_moments,
    prior_equations,
    tangent_scale,
    total,
    weight_matrices,
    weighted_residuals,
)
from sfgs_jax.gicp._sweep import RowMotion, Sweep
from sfgs_jax.gicp.clouds import OrganisedLevel, PointLevel

Levels = tuple[OrganisedLevel, ...] | tuple[PointLevel, ...]
"""Levels of a cloud, from the finest to the coarsest."""


class Minimum(eqx.Module):
    """End of the steps of one level, or of all.

    Attributes:
        T_target_source: motion between the levels' coordinates.
        iterations: number of steps.
        converged: whether the last step was short.
    """

    T_target_source: jaxlie.SE3
    iterations: Int[Array, ""]
    converged: Bool[Array, ""]


class LevelProblem(eqx.Module):
    """One level of a source and a target, as a least-squares problem over the motion between them.

    Every step finds the correspondences and weights of its motion and holds them fixed, as in Segal et al.,
    Generalized-ICP (RSS 2009). The function `level_problem` makes one.

    Attributes:
        source: points to align.
        target: surface to align them with.
        moments: (10, N) `point_moments` of the source points.
        prior: prior of the motion; None without one.
        sweep: motion while the source was read, by which its points move with the motion sought; None where
            they do not.
        voxel_size: of the coarser unorganised cloud, metres; None if both are depth images.
        kernel_width: width of the robust kernel at this level, standard deviations; static.
        redundancy: source points per independent measurement: windows of neighbouring pixels share most of
            their depths. A prior is weighed up by it. Static.
        decimation: number of points to align per point of this problem; static.
        max_iterations: most steps; static.
        tolerance: length of a step, metres and radians, below which the level has converged; static.
        config: settings; static.
    """

    source: SourcePoints
    target: TargetSurface
    moments: Float[Array, "10 N"]
    prior: MotionPrior | None
    sweep: Sweep | None
    voxel_size: Float[Array, ""] | None
    kernel_width: float = eqx.field(static=True)
    redundancy: float = eqx.field(static=True)
    decimation: int = eqx.field(static=True)
    max_iterations: int = eqx.field(static=True)
    tolerance: float = eqx.field(static=True)
    config: GicpConfig = eqx.field(static=True)

    def at(self, T_target_source: jaxlie.SE3) -> "LevelProblem":
        """The problem with its points where they are if this is the motion."""
        return self if self.sweep is None else self.with_moving_rows(self.sweep.at(T_target_source))

    def with_moving_rows(self, moving: RowMotion) -> "LevelProblem":
        """The problem with the points of a source that was read with a given motion."""
        source = with_moving_rows(self.source, moving)
        return replace(self, source=source, moments=point_moments(source.points), sweep=None)

    def correspondences(self, T_target_source: jaxlie.SE3) -> Correspondences:
        """Correspondences at a motion."""
        return associate(self.source, self.target, T_target_source)[0]

    def normal_distances(self, pairs: Correspondences) -> Float[Array, " N"]:
        """Distance of each correspondence along the mean of its two normals, metres."""
        mean = self.source.normals + pairs.normals
        along = dot(self.source.points - pairs.points, mean)
        return along * lax.rsqrt(jnp.where(pairs.valid, dot(mean, mean), 1))

    def robust_weights(self, pairs: Correspondences) -> Float[Array, " N"]:
        """Robust weight times inverse variance of each correspondence; 0 where there is none."""
        square = self.normal_distances(pairs) ** 2 / pairs.variance
        robust = kernel_weight(square, self.config.kernel, self.kernel_width)
        return jnp.where(pairs.valid, robust / pairs.variance, 0)

    def equations(self, T_target_source: jaxlie.SE3, pairs: Correspondences) -> NormalEquations:
        """Normal equations at a motion with its correspondences."""
        weights = self.robust_weights(pairs)
        matrices = self._weight_matrices(pairs) * weights[None]
        residuals = self.source.points - pairs.points
        matrix_sums, residual_sums, weight_sums = moment_sums(
            self.moments, matrices, weighted_residuals(matrices, residuals), weights
        )
        full = geometric = hessian(matrix_sums)
        if self.config.residual == "gicp":
            # The weight of all directions alike only holds correspondences together: it observes no motion.
            geometric = full - self.config.epsilon * isotropic_hessian(weight_sums)
        prior, cost = None, self._cost(pairs)
        if self.prior is not None:
            prior_hessian, prior_gradient, prior_cost = prior_equations(self.prior, T_target_source)
            prior = self.redundancy * prior_hessian, self.redundancy * prior_gradient
            cost = cost + prior_cost
        return NormalEquations(
            hessian=full,
            gradient=gradient(residual_sums),
            geometric_hessian=geometric,
            prior=prior,
            scale=tangent_scale(weight_sums),
            weight=total(weight_sums),
            cost=cost,
        )

    def _weight_matrices(self, pairs: Correspondences) -> Float[Array, "6 N"]:
        """Weight matrices of the residuals, about 1 along the normals."""
        normals, epsilon = self.source.normals, self.config.epsilon
        if self.config.residual == "gicp" and pairs.covariances is not None:
            return covariance_weight_matrices(normals, pairs.covariances, epsilon=epsilon)
        return weight_matrices(normals, pairs.normals, residual=self.config.residual, epsilon=epsilon)

    def _cost(self, pairs: Correspondences) -> Float[Array, ""]:
        """Robust cost per redundancy; a point without a correspondence costs like the farthest inlier."""
        square = jnp.where(pairs.valid, self.normal_distances(pairs) ** 2 / pairs.variance, 0)
        lost = jnp.full_like(square[:1], (self.config.inlier_width * self.kernel_width) ** 2)
        rho = kernel_rho(jnp.where(pairs.valid, square, lost), self.config.kernel, self.kernel_width)
        return jnp.sum(self.source.valid.astype(square.dtype) * rho) / 2 / self.redundancy

    def minimise(self, T_target_source: jaxlie.SE3, skipped: Bool[Array, ""]) -> Minimum:
        """Steps from a motion until they are short; a level that is skipped takes none."""
        if self.max_iterations == 0:
            return Minimum(T_target_source, jnp.asarray(0), skipped)
        if self.config.optimizer == "gauss_newton":
            return self._gauss_newton(T_target_source, skipped)
        return self._levenberg_marquardt(T_target_source, skipped)

    def _gauss_newton(self, T: jaxlie.SE3, skipped: Bool[Array, ""]) -> Minimum:
        damping = jnp.asarray(self.config.damping, self.moments.dtype)

        def unfinished(state: Minimum) -> Bool[Array, ""]:
            return (state.iterations < self.max_iterations) & ~state.converged

        def step(state: Minimum) -> Minimum:
            T = state.T_target_source
            now = self.at(T)
            T, short = self._moved(T, now.equations(T, now.correspondences(T)), damping)
            return Minimum(T, state.iterations + 1, short)

        return lax.while_loop(unfinished, step, Minimum(T, jnp.asarray(0), skipped))

    def _levenberg_marquardt(self, T: jaxlie.SE3, skipped: Bool[Array, ""]) -> Minimum:
        """Levenberg-Marquardt; the cost of a trial comes from its own correspondences, not from a model."""
        damping = jnp.asarray(self.config.damping, self.moments.dtype)

        def unfinished(state: _Trial) -> Bool[Array, ""]:
            return (state.iterations < self.max_iterations) & ~state.converged

        def step(state: _Trial) -> _Trial:
            T, short = self._moved(state.T, state.equations, state.damping)
            now = self.at(T)
            equations = now.equations(T, now.correspondences(T))
            # A change of the cost below its rounding is no rise.
            better = equations.cost <= state.equations.cost * (1 + 1e-5)
            T, equations = jax.tree.map(
                lambda new, old: jnp.where(better, new, old), (T, equations), (state.T, state.equations)
            )
            damping = jnp.clip(state.damping * jnp.where(better, 0.1, 10), 1e-6, 1e6)
            return _Trial(T, equations, damping, state.iterations + 1, short)

        now = self.at(T)
        start = _Trial(T, now.equations(T, now.correspondences(T)), damping, jnp.asarray(0), skipped)
        end = lax.while_loop(unfinished, step, start)
        return Minimum(end.T, end.iterations, end.converged)

    def _moved(
        self, T: jaxlie.SE3, equations: NormalEquations, damping: Float[Array, ""]
    ) -> tuple[jaxlie.SE3, Bool[Array, ""]]:
        """Motion after a step, and whether the step was short."""
        delta = damped_step(equations, damping, self.config.step_observability)
        square = jnp.maximum(jnp.sum(delta[:3] ** 2), jnp.sum(delta[3:] ** 2))
        return se3.compose(T, se3.exp(delta)), square < self.tolerance**2


class _Trial(eqx.Module):
    """State of Levenberg-Marquardt."""

    T: jaxlie.SE3
    equations: NormalEquations
    damping: Float[Array, ""]
    iterations: Int[Array, ""]
    converged: Bool[Array, ""]


@checked
def level_problem(
    source: Levels,
    target: Levels,
    prior: MotionPrior | None,
    index: int,
    config: GicpConfig,
    *,
    sweep: Sweep | None = None,
    noise: DistanceNoise | None = None,
    decimation: int = 1,
) -> LevelProblem:
    """Problem of a level; a cloud with fewer levels repeats its coarsest.

    Args:
        source: levels of the cloud to align.
        target: levels of the cloud to align it with.
        prior: prior of the motion; None without one.
        index: level, counted from the finest.
        config: settings.
        sweep: motion while an organised source was read.
        noise: of an organised source; that of the settings if not given.
        decimation: factor by which an organised source gets fewer rows, and fewer columns, than it aligns.
    """
    level = at_level(source, index)
    if isinstance(level, PointLevel):
        decimation = 1
    stride = decimation * _stride(level, index, config)
    points = source_points(level, stride, noise or DistanceNoise(config.noise, config.noise_per_square_metre))
    return LevelProblem(
        source=points,
        target=target_surface(at_level(target, index), index, config),
        moments=point_moments(points.points),
        prior=prior,
        sweep=sweep,
        voxel_size=_voxel_size(level, at_level(target, index)),
        kernel_width=config.kernel_width * 2**index,
        redundancy=_redundancy(level, stride, config),
        decimation=decimation**2,
        max_iterations=at_level(config.max_iterations, index),
        tolerance=at_level(config.tolerance, index),
        config=config,
    )


def _stride(level: OrganisedLevel | PointLevel, index: int, config: GicpConfig) -> int:
    """Step between the rows and columns to align; small images keep `min_points`."""
    kept = level.valid.size // at_level(config.min_points, index)
    return max(1, min(at_level(config.strides, index), math.isqrt(kept)))


def _voxel_size(*levels: OrganisedLevel | PointLevel) -> Float[Array, ""] | None:
    sizes = [level.voxel_size for level in levels if isinstance(level, PointLevel)]
    return jnp.max(jnp.stack(sizes)) if sizes else None


def _redundancy(level: OrganisedLevel | PointLevel, stride: int, config: GicpConfig) -> float:
    """Source points per independent measurement: those in the window of a depth image's surface."""
    if isinstance(level, PointLevel):
        return 1.0
    return max(1.0, ((2 * config.radius + 1) / stride) ** 2)
