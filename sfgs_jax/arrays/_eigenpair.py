"""Eigenvector of the smallest eigenvalue of symmetric 3 x 3 matrices in closed form: a plane's normal."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax.arrays._small_matrices import (
    Symmetric,
    identity_like,
    outer,
    symmetric_inverse,
    symmetric_product,
)


@jax.custom_jvp
def smallest_eigenpair(matrices: Symmetric) -> tuple[Float[Array, " N"], Float[Array, "3 N"]]:
    """Smallest eigenvalue and its unit eigenvector, of either sign, of positive semi-definite matrices.

    The eigenvalue comes from Smith, Eigenvalues of a symmetric 3x3 matrix (CACM 1961). The eigenvector is
    the longest cross product of two rows of A - lambda I, which is orthogonal to all of them. For a double
    eigenvalue it is any vector of its plane, (0, 0, 1) for a multiple of the identity, with a derivative
    of 0.

    Args:
        matrices: upper triangles xx xy xz yy yz zz.
    """
    trace = matrices[0] + matrices[3] + matrices[5]
    scale = jnp.where(trace > 0, trace, 1)
    xx, xy, xz, yy, yz, zz = matrices / scale[None]
    mean = (xx + yy + zz) / 3
    a, b, c = xx - mean, yy - mean, zz - mean
    p = jnp.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    ratio = jnp.clip(determinant / (2 * jnp.where(p > 1e-12, p, 1) ** 3), -1, 1)
    value = mean + 2 * p * jnp.cos(jnp.arccos(ratio) / 3 + 2 * jnp.pi / 3)

    rows = (xx - value, xy, xz), (xy, yy - value, yz), (xz, yz, zz - value)
    best, length = jnp.zeros_like(matrices[:3]), jnp.zeros_like(trace)
    for i, j in ((0, 1), (0, 2), (1, 2)):
        cross = _cross(rows[i], rows[j])
        square = jnp.sum(cross * cross, axis=0)
        best, length = jnp.where(square > length, cross, best), jnp.maximum(length, square)
    limit = (10 * float(jnp.finfo(matrices.dtype).eps)) ** 2
    simple = length > limit
    unit = best * lax.rsqrt(jnp.where(simple, length, 1))[None]
    vector = jnp.where(simple, unit, _perpendicular(rows, limit))
    # The quotient of the eigenvector is exact to second order in the vector's error.
    return jnp.maximum(_quadratic(matrices, vector), 0), vector


@smallest_eigenpair.defjvp
def _smallest_eigenpair_jvp(
    primals: tuple[Symmetric], tangents: tuple[Symmetric]
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """d lambda = v^T dA v and d v = -(A - lambda I)^+ dA v."""
    (matrices,), (change,) = primals, tangents
    value, vector = smallest_eigenpair(matrices)
    trace = matrices[0] + matrices[3] + matrices[5]
    scale = jnp.where(trace > 0, trace, 1)
    pull = symmetric_product(change, vector)
    along = jnp.sum(vector * pull, axis=0)
    # Adding v v^T makes the matrix invertible and leaves the complement of v alone.
    shifted = (matrices - value[None] * identity_like(value)) / scale[None]
    inverse, simple = symmetric_inverse(shifted + outer(vector))
    turned = symmetric_product(inverse, pull - along[None] * vector) / scale[None]
    return (value, vector), (along, jnp.where(simple, -turned, 0))


def _quadratic(matrices: Symmetric, vectors: Float[Array, "3 N"]) -> Float[Array, " N"]:
    return jnp.sum(vectors * symmetric_product(matrices, vectors), axis=0)


def _cross(a: tuple[Array, ...], b: tuple[Array, ...]) -> Float[Array, "3 N"]:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _perpendicular(rows: tuple[tuple[Array, ...], ...], limit: float) -> Float[Array, "3 N"]:
    """Unit vectors orthogonal to rows that are all multiples of one; (0, 0, 1) where they vanish."""
    row, length = jnp.zeros_like(jnp.stack(rows[0])), jnp.zeros_like(rows[0][0])
    for candidate in map(jnp.stack, rows):
        square = jnp.sum(candidate * candidate, axis=0)
        row, length = jnp.where(square > length, candidate, row), jnp.maximum(length, square)
    x, y, z = row
    zero = jnp.zeros_like(x)
    flat = jnp.where(jnp.abs(x) > jnp.abs(z), jnp.stack([-y, x, zero]), jnp.stack([zero, -z, y]))
    known = length > limit
    unit = flat * lax.rsqrt(jnp.where(known, jnp.sum(flat * flat, axis=0), 1))[None]
    return jnp.where(known, unit, jnp.stack([zero, zero, zero + 1]))
