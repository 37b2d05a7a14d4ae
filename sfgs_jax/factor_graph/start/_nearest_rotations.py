"""Nearest rotations to matrices, by the polar decomposition."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

POLAR_STEPS = 12
"""Newton steps: enough for singular values 1000 apart."""


def nearest_rotations(matrices: Float[Array, "P 3 3"]) -> tuple[Float[Array, "P 3 3"], Bool[Array, " P"]]:
    """Orthogonal factors of the polar decomposition, and the matrices that have a rotation for one.

    These are the matrices with a positive determinant. Newton's iteration X <- (X + X^-T) / 2 starts at the
    matrix scaled to determinant 1. Source: Higham, Computing the polar decomposition, with applications
    (1986), eq. 3.3.
    """
    X = jnp.moveaxis(matrices, 0, -1)  # lanes last, for SIMD
    largest = jnp.max(jnp.abs(X), axis=(0, 1))
    # The determinant of a small matrix may be less than float32 can hold.
    X /= jnp.where(largest > 0, largest, 1)[None, None]
    volume = jnp.sum(X[0] * _cofactors(X)[0], axis=0)
    proper = volume > 0
    one = jnp.eye(3, dtype=X.dtype)[:, :, None]
    X = jnp.where(proper[None, None], X / jnp.cbrt(jnp.where(proper, volume, 1))[None, None], one)
    for _ in range(POLAR_STEPS):
        cofactors = _cofactors(X)
        X = (X + cofactors / jnp.sum(X[0] * cofactors[0], axis=0)[None, None]) / 2
    return jnp.moveaxis(X, -1, 0), proper


def _cofactors(X: Float[Array, "3 3 P"]) -> Float[Array, "3 3 P"]:
    """Determinant times inverse transpose."""
    return jnp.stack([jnp.cross(X[i - 2], X[i - 1], axis=0) for i in range(3)])
