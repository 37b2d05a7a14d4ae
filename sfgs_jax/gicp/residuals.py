"""What a correspondence measures, and how much it counts."""

from typing import assert_never

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.gicp.config import Kernel, Residual

# Rows and columns of the six entries xx, xy, xz, yy, yz, zz of a symmetric 3 x 3 matrix.
ROWS = (0, 0, 0, 1, 1, 2)
COLUMNS = (0, 1, 2, 1, 2, 2)


def weight_matrices(
    source_normals: Float[Array, "N 3"],
    target_normals: Float[Array, "N 3"],
    *,
    residual: Residual,
    epsilon: float,
) -> Float[Array, "6 N"]:
    """Weight of a residual vector p - q in each direction, xx xy xz yy yz zz; 1 along the normal.

    `point_to_point` weighs all directions alike, `point_to_plane` only the target's normal. `gicp` is the
    plane-to-plane weight of Segal, Haehnel and Thrun, Generalized-ICP (RSS 2009), eq. 2 and section III-B:
    the inverse of the sum of both points' covariances, each of variance `epsilon` along its normal and 1
    within its plane; times 2 epsilon here, so that the unit is the variance along the normal.
    """
    s, t = source_normals.T, target_normals.T
    entries = tuple(zip(ROWS, COLUMNS, strict=True))
    match residual:
        case "point_to_point":
            one = jnp.ones_like(s[0])
            return jnp.stack([one * float(i == j) for i, j in entries])
        case "point_to_plane":
            return jnp.stack([t[i] * t[j] for i, j in entries])
        case "gicp":
            total = [2.0 * (i == j) - (1 - epsilon) * (s[i] * s[j] + t[i] * t[j]) for i, j in entries]
            return 2 * epsilon * inverse_symmetric(jnp.stack(total))
        case _:
            assert_never(residual)


def inverse_symmetric(m: Float[Array, "6 N"]) -> Float[Array, "6 N"]:
    """Inverses of symmetric positive definite 3 x 3 matrices by cofactors."""
    xx, xy, xz, yy, yz, zz = m
    cofactors = jnp.stack(
        [
            yy * zz - yz * yz,
            xz * yz - xy * zz,
            xy * yz - xz * yy,
            xx * zz - xz * xz,
            xy * xz - xx * yz,
            xx * yy - xy * xy,
        ]
    )
    return cofactors / (xx * cofactors[0] + xy * cofactors[1] + xz * cofactors[2])


def kernel_weight(square: Float[Array, " N"], kernel: Kernel, width: float) -> Float[Array, " N"]:
    """Weight of a squared residual, in variances, in iteratively reweighted least squares."""
    match kernel:
        case "none":
            return jnp.ones_like(square)
        case "huber":
            large = square > width**2
            return jnp.where(large, width / jnp.sqrt(jnp.where(large, square, 1)), 1)
        case "geman_mcclure":
            return 1 / (1 + square / width**2) ** 2
        case _:
            assert_never(kernel)
