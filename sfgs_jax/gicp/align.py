"""Coarse-to-fine alignment of organised clouds."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import InputError, se3
from sfgs_jax.gicp.cloud import OrganisedCloud, OrganisedLevel
from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.correspondences import (
    Correspondences,
    Samples,
    TargetRows,
    associate,
    dot,
    sample,
    target_rows,
)
from sfgs_jax.gicp.normal_equations import normal_equations, point_moments
from sfgs_jax.gicp.residuals import kernel_weight, weight_matrices
from sfgs_jax.gicp.result import RegistrationResult

_State = tuple[jaxlie.SE3, Int[Array, ""], Bool[Array, ""]]


def align(
    source: OrganisedCloud,
    target: OrganisedCloud,
    init_T_target_source: jaxlie.SE3,
    *,
    config: GicpConfig | None = None,
) -> RegistrationResult:
    """Motion that lays the source on the target, from a start near it.

    Gauss-Newton with projective correspondences, from the coarsest level to the finest. Correspondences and
    weights are frozen in each step, as in Segal et al., Generalized-ICP (RSS 2009).

    Args:
        source: cloud of the frame to locate, from `prepare`.
        target: cloud of the frame to locate it in, with the same number of levels.
        init_T_target_source: where to start.
        config: settings, `GicpConfig()` if not given.

    Raises:
        InputError: the clouds' levels don't match each other or the config.
    """
    config = GicpConfig() if config is None else config
    counts = len(source.levels), len(target.levels), len(config.strides), len(config.max_iterations)
    if set(counts) != {config.levels}:
        raise InputError(
            f"The source has {counts[0]} levels, the target {counts[1]}, the config {config.levels} with "
            f"{counts[2]} strides and {counts[3]} iteration limits; prepare both clouds with this config."
        )
    return _align(source, target, init_T_target_source, config)


@partial(jax.jit, static_argnames="config")
def _align(
    source: OrganisedCloud, target: OrganisedCloud, T: jaxlie.SE3, config: GicpConfig
) -> RegistrationResult:
    total = jnp.asarray(0)
    settled = jnp.asarray(False)
    for i in reversed(range(config.levels)):
        samples = sample(source.levels[i], config.strides[i])
        T, iterations, settled = _align_level(samples, target.levels[i], T, i, config)
        total += iterations
    samples = sample(source.levels[0], config.strides[0])
    return _assess(samples, target.levels[0], T, total, settled, config)


def _align_level(
    source: Samples, target: OrganisedLevel, T: jaxlie.SE3, level: int, config: GicpConfig
) -> _State:
    moments = point_moments(source.points)
    rows = target_rows(target)

    def unfinished(state: _State) -> Bool[Array, ""]:
        _, iteration, settled = state
        return (iteration < config.max_iterations[level]) & ~settled

    def step(state: _State) -> _State:
        T, iteration, _ = state
        pairs = _associate(source, rows, T, level, config)
        residuals = source.points - pairs.points
        weights = weight_matrices(
            source.normals, pairs.normals, residual=config.residual, epsilon=config.epsilon
        )
        weights = weights * _confidence(source, pairs, level, config)
        hessian, gradient = normal_equations(moments, weights, residuals)
        delta = -_solve(hessian, gradient, config.damping)
        settled = (jnp.sum(delta[:3] ** 2) < config.tolerance**2) & (
            jnp.sum(delta[3:] ** 2) < config.tolerance**2
        )
        return se3.compose(T, se3.exp(delta)), iteration + 1, settled

    return lax.while_loop(unfinished, step, (T, jnp.asarray(0), jnp.asarray(False)))


def _associate(
    source: Samples, target: TargetRows, T: jaxlie.SE3, level: int, config: GicpConfig
) -> Correspondences:
    return associate(
        source,
        target,
        T,
        max_distance=config.max_distance * 2**level,
        min_normal_cosine=config.min_normal_cosine,
    )


def _normal_distance(source: Samples, pairs: Correspondences) -> Float[Array, " N"]:
    """Distance along the mean of the two normals, metres: what the residual is judged by."""
    mean = source.normals + pairs.normals
    along = dot(source.points - pairs.points, mean)
    return along * lax.rsqrt(jnp.where(pairs.found, dot(mean, mean), 1))


def _deviation(source: Samples, config: GicpConfig) -> Float[Array, " N"]:
    """Standard deviation expected of a distance along the normal, metres."""
    return config.noise + config.noise_per_square_metre * source.points[2] ** 2


def _confidence(
    source: Samples, pairs: Correspondences, level: int, config: GicpConfig
) -> Float[Array, " N"]:
    """Inverse variance times robust weight; 0 without a correspondence."""
    variance = _deviation(source, config) ** 2
    square = _normal_distance(source, pairs) ** 2 / variance
    robust = kernel_weight(square, config.kernel, config.kernel_width * 2**level)
    return jnp.where(pairs.found, robust / variance, 0)


def _solve(hessian: Float[Array, "6 6"], gradient: Float[Array, "6"], damping: float) -> Float[Array, "6"]:
    """Damped solution; 0 where there is nothing to solve. Columns are scaled first, for float32."""
    diagonal = jnp.diagonal(hessian)
    known = diagonal > 0
    scale = jnp.where(known, lax.rsqrt(jnp.where(known, diagonal, 1)), 0)
    scaled = hessian * scale[:, None] * scale[None, :]
    damped = scaled + jnp.diag(jnp.where(known, damping, 1).astype(hessian.dtype))
    return scale * jax.scipy.linalg.solve(damped, scale * gradient, assume_a="pos")


def _assess(
    source: Samples,
    target: OrganisedLevel,
    T: jaxlie.SE3,
    iterations: Int[Array, ""],
    settled: Bool[Array, ""],
    config: GicpConfig,
) -> RegistrationResult:
    """How well the finest level fits, and how firmly that fixes the motion.

    What a projective correspondence misses across the normal is found by no residual (the next pixel is
    always near), so only distances along the normals inform, unless all that is asked for is points.
    """
    pairs = _associate(source, target_rows(target), T, 0, config)
    distance = _normal_distance(source, pairs)
    inlier = pairs.found & (jnp.abs(distance) < config.inlier_width * _deviation(source, config))
    share = inlier.astype(distance.dtype)
    count = jnp.sum(share)
    fraction = count / jnp.maximum(jnp.sum(source.valid.astype(distance.dtype)), 1)
    rmse = jnp.sqrt(jnp.sum(share * distance**2) / jnp.maximum(count, 1))

    residual = "point_to_point" if config.residual == "point_to_point" else "point_to_plane"
    directions = weight_matrices(source.normals, pairs.normals, residual=residual, epsilon=config.epsilon)
    moments, residuals = point_moments(source.points), source.points - pairs.points
    confidence = _confidence(source, pairs, 0, config) * share
    hessian, _ = normal_equations(moments, directions * confidence, residuals)
    excess = jnp.sum(confidence * distance**2) / jnp.maximum(
        jnp.sum(confidence * _deviation(source, config) ** 2), 1
    )
    shared = max(1.0, ((2 * config.radius + 1) / config.strides[0]) ** 2)
    information = hessian / (shared * jnp.maximum(excess, 0.01))

    geometry, _ = normal_equations(moments, directions * share, residuals)
    spread = jnp.sqrt(jnp.sum(share * source.points**2) / jnp.maximum(count, 1))
    unit = jnp.where(jnp.arange(6) < 3, 1, 1 / jnp.maximum(spread, 1e-3))
    values, vectors = jnp.linalg.eigh(geometry * unit[:, None] * unit[None, :] / jnp.maximum(count, 1))
    converged = settled & (count >= config.min_inliers) & (fraction >= config.min_inlier_fraction)
    return RegistrationResult(
        T, information, rmse, fraction, iterations, converged, values, vectors * unit[:, None]
    )
