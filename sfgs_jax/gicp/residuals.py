"""What a correspondence measures, and how much it counts."""

from typing import assert_never

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.gicp.config import Residual
from sfgs_jax.gicp.symmetric import INDICES, Symmetric, symmetric_inverse


def weight_matrices(
    source_normals: Float[Array, "3 N"],
    target_normals: Float[Array, "3 N"],
    *,
    residual: Residual,
    epsilon: float,
) -> Float[Array, "6 N"]:
    """Weight of a residual vector p - q in each direction, xx xy xz yy yz zz; about 1 along the normal.

    `point_to_point` weighs all directions alike, `point_to_plane` only the target's normal. `gicp` is the
    plane-to-plane weight of Segal, Haehnel and Thrun, Generalized-ICP (RSS 2009), eq. 2 and section III-B:
    the inverse of the sum of both points' covariances, each of variance `epsilon` along its normal and 1
    within its plane; times 2 epsilon here, so that the unit is the variance along the normal. With
    k = 1 - epsilon and unit normals s and t that sum is 2 I - k (s s^T + t t^T), whose eigenvectors are
    s + t and s - t, so the inverse needs no matrix inversion.
    """
    s, t = source_normals, target_normals
    match residual:
        case "point_to_point":
            return jnp.stack([jnp.full_like(s[0], float(i == j)) for i, j in INDICES])
        case "point_to_plane":
            return jnp.stack([t[i] * t[j] for i, j in INDICES])
        case "gicp":
            k, cosine = 1 - epsilon, s[0] * t[0] + s[1] * t[1] + s[2] * t[2]
            along = epsilon * k / (4 - 2 * k * (1 + cosine))
            across = epsilon * k / (4 - 2 * k * (1 - cosine))
            mean, difference = s + t, s - t
            return jnp.stack(
                [
                    epsilon * (i == j) + along * mean[i] * mean[j] + across * difference[i] * difference[j]
                    for i, j in INDICES
                ]
            )
        case _:
            assert_never(residual)


def shape_weights(
    source_normals: Float[Array, "3 N"], target_shapes: Symmetric, *, epsilon: float
) -> Float[Array, "6 N"]:
    """`gicp` weights where the target's covariances are given, with a largest variance of 1."""
    s, keep = source_normals, 1 - epsilon
    source = jnp.stack([float(i == j) - keep * s[i] * s[j] for i, j in INDICES])
    inverse, _ = symmetric_inverse(source + target_shapes)
    return 2 * epsilon * inverse
