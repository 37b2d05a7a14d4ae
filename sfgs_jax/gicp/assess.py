"""How well an alignment fits, and how firmly that fixes the motion."""

import jax.numpy as jnp
from jax import lax

from sfgs_jax.gicp.config import GicpConfig
from sfgs_jax.gicp.level import LevelProblem
from sfgs_jax.gicp.locate import Located
from sfgs_jax.gicp.normal_equations import hessian, moment_sums, squared_radius, total
from sfgs_jax.gicp.residuals import weight_matrices
from sfgs_jax.gicp.result import RegistrationResult
from sfgs_jax.gicp.spatial_hash import SpatialHash
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
    residual = "point_to_point" if config.residual == "point_to_point" else "point_to_plane"
    along = weight_matrices(source.normals, pairs.normals, residual=residual, epsilon=config.epsilon)
    weights = confidence(source, pairs, problem.width, config) * share
    squares = distance**2
    informing, weighing, inliers, *scalars = moment_sums(
        problem.moments,
        along * weights,
        weights,
        share,
        share * squares,
        weights * squares,
        weights * pairs.variance,
        pairs.met.astype(share.dtype),
        source.valid.astype(share.dtype),
    )
    count = total(inliers)
    missed, weighed, expected, met, points = map(total, scalars)
    fraction = count / jnp.maximum(points, 1)
    rmse = jnp.sqrt(missed / jnp.maximum(count, 1))
    excess = weighed / jnp.maximum(expected, 1)
    spread = jnp.sqrt(squared_radius(weighing, least=1e-6))
    unit = jnp.where(jnp.arange(6) < 3, 1, 1 / jnp.maximum(spread, 1e-3))
    outer = unit[:, None] * unit[None, :]
    # Weighed like the residuals: errors of the near points' normals drown what a few far points know.
    geometry = hessian(informing) * outer
    values, vectors = jnp.linalg.eigh(geometry / jnp.maximum(total(weighing), 1e-6))
    free = values < config.min_observability
    # Where two directions are fixed equally well, eigenvectors have no derivative.
    fixed = lax.stop_gradient(jnp.where(free, 0, vectors))
    known = fixed @ fixed.T
    information = known @ geometry @ known / outer / (problem.shared * jnp.maximum(excess, 0.01))
    # Many points may have the same nearest one: a list of a few of them supports nothing.
    search = problem.target.search
    supported = count * problem.thinned >= config.min_inliers
    if isinstance(search, SpatialHash):
        supported = supported & (search.starts[-1] >= config.min_inliers)
    converged = found.settled & supported & (fraction >= config.min_inlier_fraction)
    return RegistrationResult(
        T,
        information,
        rmse,
        fraction,
        met / jnp.maximum(points, 1),
        found.iterations,
        converged,
        values,
        vectors * unit[:, None],
        free,
    )
