"""Assessment of an alignment: how well it fits, and how firmly the geometry fixes the motion."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import Text, printed_count, printed_fields
from sfgs_jax.geometry import se3
from sfgs_jax.gicp._correspondences import Correspondences
from sfgs_jax.gicp._exact_products import exact_products
from sfgs_jax.gicp._level_problem import LevelProblem, Minimum
from sfgs_jax.gicp._normal_equations import hessian, moment_sums, squared_radius, total, weight_matrices
from sfgs_jax.gicp.clouds import SpatialHash

ASSESSMENT_DECIMATION = 2
"""An assessment takes every second row and column of the points aligned: the windows of neighbours share most
of their pixels."""


_CORRELATION = 0.00125
"""Intraclass correlation of the distances between unorganised clouds. They share errors of the normals and of
the surfaces' sampling, so more than 800 of them fix a motion no better."""

_VOXEL_ERROR = 0.0025
"""Error that all means of voxels share, as a share of a voxel: surfaces bend between them. Both figures are
fitted to exact depth and to depth with noise (experiments/point_cloud_covariance.py)."""


class RegistrationResult(eqx.Module):
    """A motion with measures of its quality.

    Attributes:
        T_target_source: the motion found.
        information: (6, 6) information matrix of that motion in the tangent at it (translation first, right
            perturbation), metres and radians: the weight of a pose-graph edge. Only distances along the
            normals count, and nothing along free directions, so along a bare wall it is zero. Of unorganised
            clouds it allows for errors that all points share.
        rmse: root mean square distance along the normals of the inliers, metres.
        inlier_fraction: share of the source's points, of a sample at the finest level, that lie on the
            target.
        overlap: share of them that meet a surface of the target, near or not. In an organised target their
            pixel shows a surface, in an unorganised one a point is in reach. Points that do not overlap may
            be right without being inliers, so only an `inlier_fraction` below this share speaks against the
            motion.
        unmeasured: share of them that meet a hole: the target looks there and has no depth.
        iterations: number of steps over all levels.
        converged: the last steps were short, and there are enough inliers.
        observability: (6,) how well the geometry fixes each direction of motion, ascending: the mean of the
            squared distance along the normals that a unit motion makes. It is weighted like the residuals,
            with rotations as arc length at the cloud's radius.
        directions: (6, 6) the directions as columns, tangent vectors of the motion.
        free: (6,) directions that the geometry leaves free, by `GicpConfig.min_observability`; the motion
            keeps the start's part along them.
    """

    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]
    rmse: Float[Array, ""]
    inlier_fraction: Float[Array, ""]
    overlap: Float[Array, ""]
    unmeasured: Float[Array, ""]
    iterations: Int[Array, ""]
    converged: Bool[Array, ""]
    observability: Float[Array, "6"]
    directions: Float[Array, "6 6"]
    free: Bool[Array, "6"]

    def __repr__(self) -> str:
        return printed_fields(
            "RegistrationResult",
            rmse=(self.rmse, "m"),
            T_target_source=Text(se3.text_of(self.T_target_source)),
            inlier_fraction=self.inlier_fraction,
            overlap=self.overlap,
            iterations=self.iterations,
            converged=self.converged,
            free=Text(f"{printed_count(self.free)} directions"),
        )

    @property
    @exact_products
    def covariance(self) -> Float[Array, "6 6"]:
        """(6, 6) inverse of `information`, metres and radians; infinite entries if any direction is free."""
        # The directions are the eigenvectors, but for their units, so that nothing has to be solved.
        along = jnp.sum(self.directions * (self.information @ self.directions), axis=0)
        known = jnp.all(~self.free & (along > 0))
        inverse = (self.directions / jnp.where(known, along, 1)[None]) @ self.directions.T
        return jnp.where(known, inverse, jnp.inf)


@exact_products
def assess(problem: LevelProblem, minimum: Minimum) -> RegistrationResult:
    """Quality of a motion by the finest level, in the coordinates of the levels.

    Only distances along the normals inform, unless the residual is `point_to_point`. Across the normals no
    residual shows an error: the next pixel is always near, and a list's nearest point is off by its spacing.

    Args:
        problem: the finest level, at `ASSESSMENT_DECIMATION`.
        minimum: end of the steps.
    """
    config, source = problem.config, problem.source
    pairs = problem.correspondences(minimum.T_target_source)
    square = problem.normal_distances(pairs) ** 2
    inlier = (pairs.valid & (square < config.inlier_width**2 * pairs.variance)).astype(square.dtype)
    weights = problem.robust_weights(pairs) * inlier
    matrix_sums, weight_sums, inlier_sums, *sums = moment_sums(
        problem.moments,
        _informing(problem, pairs) * weights[None],
        weights,
        inlier,
        inlier * square,
        weights * square,
        weights * pairs.variance,
        pairs.overlap.astype(square.dtype),
        pairs.in_view.astype(square.dtype),
        source.valid.astype(square.dtype),
    )
    inliers = total(inlier_sums)
    squares, weighted_squares, expected_squares, overlapping, looked_at, points = map(total, sums)
    fraction = inliers / jnp.maximum(points, 1)
    excess = weighted_squares / jnp.maximum(expected_squares, 1)

    radius = jnp.sqrt(squared_radius(weight_sums))
    scale = jnp.where(jnp.arange(6) < 3, 1, 1 / jnp.maximum(radius, 1e-3))
    outer = scale[:, None] * scale[None, :]
    # Weighted like the residuals: otherwise errors of many near normals drown the word of a few far points.
    geometry = hessian(matrix_sums) * outer
    observability, vectors = jnp.linalg.eigh(geometry / jnp.maximum(total(weight_sums), 1e-6))
    free = observability < config.min_observability
    # Eigenvectors have no derivative if two directions are fixed equally well.
    fixed = lax.stop_gradient(jnp.where(free, 0, vectors))
    projector = fixed @ fixed.T
    inflation = problem.redundancy * jnp.maximum(excess, 0.01)
    if problem.voxel_size is not None:
        inflation += _common_error(weighted_squares, total(weight_sums), problem.voxel_size)
    information = projector @ geometry @ projector / outer / inflation
    supported = _supported(problem, inliers)
    return RegistrationResult(
        T_target_source=minimum.T_target_source,
        information=information,
        rmse=jnp.sqrt(squares / jnp.maximum(inliers, 1)),
        inlier_fraction=fraction,
        overlap=overlapping / jnp.maximum(points, 1),
        unmeasured=(looked_at - overlapping) / jnp.maximum(points, 1),
        iterations=minimum.iterations,
        converged=minimum.converged & supported & (fraction >= config.min_inlier_fraction),
        observability=observability,
        directions=vectors * scale[:, None],
        free=free,
    )


def _supported(problem: LevelProblem, inliers: Float[Array, ""]) -> Bool[Array, ""]:
    """True if there are enough inliers."""
    least = problem.config.min_inliers
    supported = inliers * problem.decimation >= least
    if isinstance(problem.target.search, SpatialHash):
        # Many points may have the same nearest one: a target of a few points supports nothing.
        supported &= problem.target.search.starts[-1] >= least
    return supported


def _common_error(
    weighted_squares: Float[Array, ""], weight: Float[Array, ""], voxel_size: Float[Array, ""]
) -> Float[Array, ""]:
    """Growth of the variance by errors that all distances have in common.

    The first term is Kish's design effect, Survey Sampling (1965): n correlated distances count like
    n / (1 + n rho) independent ones.

    Args:
        weighted_squares: sum of the distances' squares over their variances.
        weight: sum of the inverse variances.
        voxel_size: metres.
    """
    return _CORRELATION * weighted_squares + weight * (_VOXEL_ERROR * voxel_size) ** 2


def _informing(problem: LevelProblem, pairs: Correspondences) -> Float[Array, "6 N"]:
    """Weight matrices of the distances that inform."""
    residual = "point_to_point" if problem.config.residual == "point_to_point" else "point_to_plane"
    return weight_matrices(
        problem.source.normals, pairs.normals, residual=residual, epsilon=problem.config.epsilon
    )
