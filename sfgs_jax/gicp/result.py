"""What a registration returns."""

import equinox as eqx
import jaxlie
from jaxtyping import Array, Bool, Float, Int


class RegistrationResult(eqx.Module):
    """A motion with how far to trust it.

    Attributes:
        T_target_source: the motion found.
        information: (6, 6) information matrix of that motion in the tangent at it (translation first, right
            perturbation), metres and radians: what a pose-graph edge is weighted by. Only distances along
            the normals count, and nothing along what they leave free, so along a bare wall it is zero.
        rmse: root mean square distance along the normals of the inliers, metres.
        inlier_fraction: share of the source's points, of a sample at the finest level, that lie on the
            target.
        overlap: share of them that meet a surface of the target, near or not: in an organised target those
            whose pixel shows one, in an unorganised one those with a point in reach. The others may be right
            without being inliers, so what speaks against a motion is `inlier_fraction` below this share.
        iterations: steps over all levels.
        converged: the last steps were short, and there are enough inliers.
        observability: (6,) ascending, how well the geometry fixes each direction of motion: the mean of the
            squared distance along the normal that a unit motion makes, weighted like the residuals,
            rotations as arc length at the cloud's radius.
        directions: (6, 6) the directions as columns, tangent vectors of the motion.
        free: (6,) which of the directions the geometry leaves free, by `GicpConfig.min_observability`: the
            motion keeps along them what it started with.
    """

    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]
    rmse: Float[Array, ""]
    inlier_fraction: Float[Array, ""]
    overlap: Float[Array, ""]
    iterations: Int[Array, ""]
    converged: Bool[Array, ""]
    observability: Float[Array, "6"]
    directions: Float[Array, "6 6"]
    free: Bool[Array, "6"]
