"""Symmetric 3 x 3 matrices by their upper triangles: inverse and smallest eigenvector, in closed form."""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float

# Rows and columns of the six entries xx, xy, xz, yy, yz, zz of a symmetric 3 x 3 matrix.
INDICES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
# Where each entry of the matrix stands in that list. Of 32 bits whatever the mode: JAX converts a NumPy array
# once and keeps the result by identity, so that of 64 bits would cross from one mode to the other.
SQUARE = np.asarray([[0, 1, 2], [1, 3, 4], [2, 4, 5]], np.int32)
Symmetric = Float[Array, "6 N"]


@jax.custom_jvp
def smallest_eigenpair(matrices: Symmetric) -> tuple[Float[Array, " N"], Float[Array, "3 N"]]:
    """Smallest eigenvalue and its unit eigenvector, of either sign, of positive semi-definite matrices.

    The eigenvalues by Smith, Eigenvalues of a symmetric 3x3 matrix (CACM 1961); the eigenvector as the
    longest cross product of two rows of A - lambda I, which is orthogonal to all of them. `eigh` is many
    times slower on a CPU. Where the eigenvalue is double the eigenvector is any of its plane, (0, 0, 1) for
    a multiple of the identity, with a derivative of 0.

    Args:
        matrices: upper triangles xx xy xz yy yz zz.
    """
    trace = matrices[0] + matrices[3] + matrices[5]
    scale = jnp.where(trace > 0, trace, 1)
    xx, xy, xz, yy, yz, zz = matrices / scale
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
    vector = jnp.where(simple, best * lax.rsqrt(jnp.where(simple, length, 1)), _perpendicular(rows, limit))
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
    unit = jnp.stack([jnp.full_like(value, float(i == j)) for i, j in INDICES])
    outer = jnp.stack([vector[i] * vector[j] for i, j in INDICES])
    inverse, simple = symmetric_inverse((matrices - value * unit) / scale + outer)
    turned = symmetric_product(inverse, pull - along * vector) / scale
    return (value, vector), (along, jnp.where(simple, -turned, 0))


def symmetric_product(matrices: Symmetric, vectors: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """A v."""
    xx, xy, xz, yy, yz, zz = matrices
    x, y, z = vectors
    return jnp.stack([xx * x + xy * y + xz * z, xy * x + yy * y + yz * z, xz * x + yz * y + zz * z])


def symmetric_inverse(matrices: Symmetric) -> tuple[Symmetric, Bool[Array, " N"]]:
    """Inverses, 0 for the singular, and which are not singular; for matrices whose entries are about 1."""
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
    return jnp.where(regular, adjugate / jnp.where(regular, determinant, 1), 0), regular


def _quadratic(matrices: Symmetric, vectors: Float[Array, "3 N"]) -> Float[Array, " N"]:
    return jnp.sum(vectors * symmetric_product(matrices, vectors), axis=0)


def _cross(a: tuple[Array, ...], b: tuple[Array, ...]) -> Float[Array, "3 N"]:
    return jnp.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _perpendicular(rows: tuple[tuple[Array, ...], ...], limit: float) -> Float[Array, "3 N"]:
    """Unit vectors at right angles to rows that are all multiples of one; (0, 0, 1) where they vanish."""
    row, length = jnp.zeros_like(jnp.stack(rows[0])), jnp.zeros_like(rows[0][0])
    for candidate in map(jnp.stack, rows):
        square = jnp.sum(candidate * candidate, axis=0)
        row, length = jnp.where(square > length, candidate, row), jnp.maximum(length, square)
    x, y, z = row
    zero = jnp.zeros_like(x)
    flat = jnp.where(jnp.abs(x) > jnp.abs(z), jnp.stack([-y, x, zero]), jnp.stack([zero, -z, y]))
    known = length > limit
    unit = flat * lax.rsqrt(jnp.where(known, jnp.sum(flat * flat, axis=0), 1))
    return jnp.where(known, unit, jnp.stack([zero, zero, zero + 1]))
