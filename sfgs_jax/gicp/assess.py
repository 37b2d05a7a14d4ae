"""How well an alignment fits, and how firmly that fixes the motion."""

import jax.numpy as jnp

from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.level import LevelProblem
from sfgs_jax.gicp.locate import Located
from sfgs_jax.gicp.normal_equations import normal_equations
from sfgs_jax.gicp.residuals import weight_matrices
from sfgs_jax.gicp.result import RegistrationResult
from sfgs_jax.gicp.step import confidence, normal_distance


def assess(problem: LevelProblem, found: Located, config: GicpConfig) -> RegistrationResult:
    """Judge a motion by the finest level.

    What a projective correspondence misses across the normal is found by no residual (the next pixel is
    always near), and the nearest point of a list is off by the list's spacing, so only distances along the
    normals inform, unless all that is asked for is points.
    """
    source, T = problem.source, found.T_target_source
    pairs = problem.pairs(T)
    distance = normal_distance(source, pairs)
    inlier = pairs.found & (distance**2 < config.inlier_width**2 * pairs.variance)
    share = inlier.astype(distance.dtype)
    count = jnp.sum(share)
    fraction = count / jnp.maximum(jnp.sum(source.valid.astype(distance.dtype)), 1)
    rmse = jnp.sqrt(jnp.sum(share * distance**2) / jnp.maximum(count, 1))

    residual = "point_to_point" if config.residual == "point_to_point" else "point_to_plane"
    along = weight_matrices(source.normals, pairs.normals, residual=residual, epsilon=config.epsilon)
    residuals = source.points - pairs.points
    weights = confidence(source, pairs, problem.width, config) * share
    hessian, _ = normal_equations(problem.moments, along * weights, residuals)
    excess = jnp.sum(weights * distance**2) / jnp.maximum(jnp.sum(weights * pairs.variance), 1)
    information = hessian / (problem.shared * jnp.maximum(excess, 0.01))

    geometry, _ = normal_equations(problem.moments, along * share, residuals)
    spread = jnp.sqrt(jnp.sum(share * source.points**2) / jnp.maximum(count, 1))
    unit = jnp.where(jnp.arange(6) < 3, 1, 1 / jnp.maximum(spread, 1e-3))
    values, vectors = jnp.linalg.eigh(geometry * unit[:, None] * unit[None, :] / jnp.maximum(count, 1))
    converged = found.settled & (count >= config.min_inliers) & (fraction >= config.min_inlier_fraction)
    return RegistrationResult(
        T,
        information,
        rmse,
        fraction,
        found.iterations,
        converged,
        values,
        vectors * unit[:, None],
        values < config.min_observability,
    )
