"""Orders and medians by sorts of single integer keys, the only sorts that XLA does fast on a CPU."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32


def digit_bits(count: int) -> int:
    """Bits that a key may have so that it and an index below `count` fit one 32-bit word."""
    return 32 - max(count - 1, 1).bit_length()


def stable_order(*digits: UInt32[Array, " N"]) -> Int[Array, " N"]:
    """Order that sorts by the last of the digits, then by the one before, and so on.

    A radix sort from the least significant digit: each pass sorts words of a digit and the rank so far.

    Args:
        digits: keys below 2^digit_bits(N), the least significant first.
    """
    count = digits[0].shape[0]
    rank_bits = 32 - digit_bits(count)
    rank, order = jnp.arange(count, dtype=jnp.uint32), jnp.arange(count, dtype=jnp.int32)
    for digit in digits:
        words = jnp.sort((digit[order] << rank_bits) | rank)
        order = order[(words & ((1 << rank_bits) - 1)).astype(jnp.int32)]
    return order


def masked_median(values: Float[Array, " N"], valid: Bool[Array, " N"]) -> Float[Array, ""]:
    """The middle one of the valid values (the lower of two), 0 where there is none."""
    word = jnp.uint32 if values.dtype.itemsize == 4 else jnp.uint64
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(values), word)
    top = jnp.asarray(1, word) << (8 * values.dtype.itemsize - 1)
    # Floats order as their bits do once the negative ones are turned round.
    keys = jnp.where(bits & top != 0, ~bits, bits | top)
    ordered = jnp.sort(jnp.where(valid, keys, ~jnp.zeros((), word)))
    count = jnp.sum(valid)
    middle = ordered[jnp.maximum(count - 1, 0) // 2]
    found = jax.lax.bitcast_convert_type(jnp.where(middle & top != 0, middle ^ top, ~middle), values.dtype)
    # Taken from the list, which is what its derivative is with respect to.
    return jnp.where(count > 0, values[jnp.argmax(valid & (values == found))], 0)
