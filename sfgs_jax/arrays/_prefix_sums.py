"""Prefix sums of integers by matrix products with a triangle of ones."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

_WIDTH = 128
"""Numbers in a block; products with a triangle of this size run at full speed."""


def prefix_sums(counts: Int[Array, " n"]) -> Int[Array, " n"]:
    """Inclusive prefix sums, several times faster than `jnp.cumsum` on a long array.

    Blocks of 128 numbers are summed by a product with a triangle of ones, and the blocks' totals by
    `jnp.cumsum`. The products are of floats, exact while the sum over each block is below 2^24.
    """
    n = counts.shape[0]
    blocks = jnp.pad(counts, (0, -n % _WIDTH)).reshape(-1, _WIDTH).astype(jnp.float32)
    triangle = jnp.triu(jnp.ones((_WIDTH, _WIDTH), jnp.float32))
    # At the default precision, TF32 on GPUs, counts above 2048 would be rounded.
    sums = jnp.matmul(blocks, triangle, precision=jax.lax.Precision.HIGHEST).astype(jnp.int32)
    before = jnp.cumsum(sums[:, -1]) - sums[:, -1]
    return (sums + before[:, None]).reshape(-1)[:n]
