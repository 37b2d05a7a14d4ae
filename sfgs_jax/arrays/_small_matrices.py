"""Many small matrices and vectors, their entries in rows and the last axis running over the matrices.

All products are sums of a few elementwise products, which XLA fuses into one loop along the lanes. It
vectorises no product of 3 x 3 matrices and no sum over three rows. Its `eigh`, `inv` and `cholesky` of many
3 x 3 matrices take many times longer than the closed forms here.

A symmetric 3 x 3 matrix is the six entries xx, xy, xz, yy, yz, zz of its upper triangle.
"""

from collections.abc import Sequence
from functools import reduce
from operator import add

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

INDICES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Rows and columns of the six entries of a symmetric 3 x 3 matrix."""

# It has 32 bits in every mode. JAX converts a NumPy array once and keeps the result by identity, so one of
# 64 bits would cross from one mode to the other.
SQUARE = np.asarray([[0, 1, 2], [1, 3, 4], [2, 4, 5]], np.int32)
"""Place of each entry of a symmetric 3 x 3 matrix in the list of six."""

Symmetric = Float[Array, "6 N"]
"""Symmetric 3 x 3 matrices by their upper triangles."""


def multiply(a: Float[Array, "r k N"], b: Float[Array, "k c N"]) -> Float[Array, "r c N"]:
    """a b, lane by lane."""
    return reduce(add, [a[:, k, None] * b[None, k] for k in range(a.shape[1])])


def multiply_transposed(a: Float[Array, "k r N"], b: Float[Array, "k c N"]) -> Float[Array, "r c N"]:
    """a^T b, lane by lane."""
    return reduce(add, [a[k, :, None] * b[None, k] for k in range(a.shape[0])])


def apply(a: Float[Array, "r k N"], b: Float[Array, "k N"]) -> Float[Array, "r N"]:
    """a b for vectors b, lane by lane."""
    return reduce(add, [a[:, k] * b[None, k] for k in range(a.shape[1])])


def apply_transposed(a: Float[Array, "k r N"], b: Float[Array, "k N"]) -> Float[Array, "r N"]:
    """a^T b for vectors b, lane by lane."""
    return reduce(add, [a[k] * b[None, k] for k in range(a.shape[0])])


def dot(
    a: Float[Array, "3 ..."] | Sequence[Array], b: Float[Array, "3 ..."] | Sequence[Array]
) -> Float[Array, "..."]:
    """Scalar products of vectors with three entries."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def side_by_side(columns: Sequence[Array]) -> Array:
    """Arrays (...) as the columns of an array (..., K).

    They are chosen column by column. XLA computes each entry of a `jnp.stack` anew, one at a time; Gaussians
    took six times longer to project with it.
    """
    place = jnp.arange(len(columns))
    chosen = columns[-1][..., None]
    for k, column in enumerate(columns[:-1]):
        chosen = jnp.where(place == k, column[..., None], chosen)
    return chosen


def upper_triangles(matrices: Float[Array, "N 3 3"]) -> Symmetric:
    """The six entries of symmetric matrices."""
    return jnp.stack([matrices[:, i, j] for i, j in INDICES])


def from_upper_triangles(triangles: Symmetric) -> Float[Array, "N 3 3"]:
    """Inverse of `upper_triangles`."""
    return triangles[SQUARE].transpose(2, 0, 1)


def identity_like(numbers: Float[Array, " N"]) -> Symmetric:
    """Identity matrices, one a number and of its type."""
    return jnp.stack([jnp.full_like(numbers, float(i == j)) for i, j in INDICES])


def outer(vectors: Float[Array, "3 N"]) -> Symmetric:
    """v v^T."""
    return jnp.stack([vectors[i] * vectors[j] for i, j in INDICES])


def symmetric_product(matrices: Symmetric, vectors: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """A v."""
    xx, xy, xz, yy, yz, zz = matrices
    x, y, z = vectors
    return jnp.stack([xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z])


def symmetric_inverse(matrices: Symmetric) -> tuple[Symmetric, Bool[Array, " N"]]:
    """Inverses by Cramer's rule, and whether a matrix is regular; singular ones give 0.

    A matrix is singular if its determinant is within rounding, for entries of about 1.
    """
    xx, xy, xz, yy, yz, zz = matrices
    adjugate = jnp.stack(
        [
            yy * zz - yz * yz,
            xz * yz - xy * zz,
            xy * yz - xz * yy,
            xx * zz - xz * xz,
            xy * xz - xx * yz,
            xx * yy - xy * xy,
        ]
    )
    determinant = xx * adjugate[0] + xy * adjugate[1] + xz * adjugate[2]
    regular = jnp.abs(determinant) > 10 * float(jnp.finfo(matrices.dtype).eps)
    inverse = adjugate / jnp.where(regular, determinant, 1)[None]
    return jnp.where(regular[None], inverse, 0), regular


def cholesky(matrices: Float[Array, "*b 3 3"]) -> tuple[Float[Array, "*b 3 3"], Bool[Array, "*b"]]:
    """Lower Cholesky factors of 3 x 3 matrices, and whether a matrix was not positive definite.

    A pivot below ten roundings of its diagonal entry is raised to that, so the factor is finite for a
    deficient matrix too.
    """
    floor = 10 * jnp.finfo(matrices.dtype).eps
    deficient = jnp.zeros(matrices.shape[:-2], bool)
    zero = jnp.zeros(matrices.shape[:-2], matrices.dtype)
    L = [[zero] * 3 for _ in range(3)]
    for j in range(3):
        entry = matrices[..., j, j]
        least = jnp.maximum(floor * entry, jnp.finfo(matrices.dtype).tiny)
        pivot = entry - sum((L[j][k] ** 2 for k in range(j)), zero)
        deficient |= pivot < least
        L[j][j] = jnp.sqrt(jnp.maximum(pivot, least))
        for i in range(j + 1, 3):
            L[i][j] = (matrices[..., i, j] - sum((L[i][k] * L[j][k] for k in range(j)), zero)) / L[j][j]
    return jnp.stack([jnp.stack(row, axis=-1) for row in L], axis=-2), deficient


def forward_substitution(
    lower: Float[Array, "*b 3 3"], right: Float[Array, "3 ..."]
) -> Float[Array, "3 ..."]:
    """L^-1 b for lower triangles, with the entries of b in rows; its axes after those of L are columns."""
    columns = [1] * (right.ndim - lower.ndim + 1)
    entry = [[lower[..., i, j].reshape(*lower.shape[:-2], *columns) for j in range(3)] for i in range(3)]
    x = right[0] / entry[0][0]
    y = (right[1] - entry[1][0] * x) / entry[1][1]
    z = (right[2] - entry[2][0] * x - entry[2][1] * y) / entry[2][2]
    return jnp.stack([x, y, z])


def back_substitution(lower: Float[Array, "*b 3 3"], right: Float[Array, "*b 3"]) -> Float[Array, "*b 3"]:
    """L^-T b for lower triangles."""
    z = right[..., 2] / lower[..., 2, 2]
    y = (right[..., 1] - lower[..., 2, 1] * z) / lower[..., 1, 1]
    x = (right[..., 0] - lower[..., 1, 0] * y - lower[..., 2, 0] * z) / lower[..., 0, 0]
    return jnp.stack([x, y, z], axis=-1)


def gauss_jordan(rows: Float[Array, "n m"]) -> tuple[Float[Array, " n"], Float[Array, "n k"]]:
    """Pivots of the square matrix in the first columns, and its inverse times the other columns.

    Elimination without exchange of rows, which is stable for positive definite matrices. A symmetric matrix
    is one if and only if all pivots are positive; where one is 0, the rest means nothing. It is unrolled, for
    matrices of a few rows: a GPU takes a kernel or two for it, where LAPACK's calls take some twenty.
    """
    size, pivots = len(rows), []
    for k in range(size):
        pivot = rows[k, k]
        row = rows[k] / jnp.where(pivot == 0, 1, pivot)
        rows = (rows - rows[:, k, None] * row[None]).at[k].set(row)
        pivots.append(pivot)
    return jnp.stack(pivots), rows[:, size:]
