"""Lists of any length in arrays of few sizes."""

import jax.numpy as jnp
from jaxtyping import Array, Shaped


def padded(rows: Shaped[Array, "..."]) -> Shaped[Array, "..."]:
    """Rows with zeros up to the next of few sizes, so that clouds of about one size share a program."""
    count = max(rows.shape[0], 8)
    step = 1 << max(count.bit_length() - 3, 3)
    return jnp.pad(rows, [(0, -(-count // step) * step - rows.shape[0]), *[(0, 0)] * (rows.ndim - 1)])
