"""Sorts, minima and medians of single integer keys, the only ones that XLA does fast on a CPU.

Two facts carry this file. Floats that are not negative are in the order of their bits, read as integers
(IEEE 754). And a key packed into one word with a payload takes the payload along. XLA sorts one array several
times faster than two, and vectorises a minimum of words but no `argmin`.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt, UInt32


def ordered_bits(values: Float[Array, "*n"]) -> UInt[Array, "*n"]:
    """Bits of floats that are not negative, unsigned integers of the same width and in the same order.

    The top bit is 0. Infinity comes after all numbers and NaN after infinity.
    """
    return jax.lax.bitcast_convert_type(values, _word(values.dtype))


def from_ordered_bits(bits: UInt[Array, "*n"]) -> Float[Array, "*n"]:
    """Inverse of `ordered_bits`."""
    return jax.lax.bitcast_convert_type(bits, jnp.float32 if bits.dtype == jnp.uint32 else jnp.float64)


def digit_bits(count: int) -> int:
    """Bits that a digit of `stable_order` may have: with an index below `count` it fits one 32-bit word."""
    return 32 - max(count - 1, 1).bit_length()


def stable_order(*digits: UInt32[Array, " N"]) -> Int[Array, " N"]:
    """Radix sort from the least significant digit: the order by the last digit, then by the one before.

    Each pass sorts 32-bit words that hold a digit and the rank so far, so keys may have any number of bits.

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


def sort_packed(
    keys: Sequence[tuple[Int[Array, " n"] | UInt32[Array, " n"], int]],
    payload: Int[Array, " n"],
    payload_bits: int,
) -> Int[Array, " n"]:
    """Payload sorted by keys, at equal keys by itself, in one pass over 64-bit words.

    The words exist in here only: all arguments and results have 32 bits, whether or not JAX is set to 64.

    Args:
        keys: each (N,) not negative with the number of bits it takes, the most significant first.
        payload: (N,) not negative.
        payload_bits: bits of the payload; with all keys' bits at most 64.
    """
    with jax.enable_x64(True):
        words = jnp.zeros(payload.shape, jnp.uint64)
        for values, width in [*keys, (payload, payload_bits)]:
            words = (words << np.uint64(width)) | values.astype(jnp.uint64)
        # A conversion to 32 bits keeps the lower half of a word.
        lower = jnp.sort(words).astype(jnp.uint32)
    return (lower & np.uint32(2**payload_bits - 1)).astype(jnp.int32)


def stable_argsort(keys: UInt32[Array, " n"]) -> Int[Array, " n"]:
    """Positions of 32-bit keys in ascending order, equal ones in the order they have."""
    return sort_packed([(keys, 32)], jnp.arange(keys.shape[0], dtype=jnp.int32), 32)


def packed_argmin(
    values: Float[Array, "K N"],
    where: Bool[Array, "K N"] | None = None,
    *,
    index_bits: int | None = None,
) -> Int[Array, " N"]:
    """Row of the least value of each column; values within 2^(index_bits - 23) of it count as equal.

    The row takes the lowest bits of the value's, so one minimum of integers finds both. Among equal values
    the first row wins. XLA's `argmin` takes several times as long on a CPU.

    Args:
        values: K rows of numbers that are not negative.
        where: the values that count; all if not given. A column without any gives some row.
        index_bits: bits of a row's number; as few as hold K if not given. Static.
    """
    count = values.shape[0]
    bits = (count - 1).bit_length() if index_bits is None else index_bits
    mask = (1 << bits) - 1
    rows = jnp.arange(count, dtype=jnp.uint32)[:, None]
    words = (ordered_bits(values.astype(jnp.float32)) & ~jnp.uint32(mask)) | rows
    if where is not None:
        words = jnp.where(where, words, ~jnp.uint32(0))
    return jnp.minimum(jnp.min(words, axis=0) & jnp.uint32(mask), count - 1).astype(jnp.int32)


def masked_median(values: Float[Array, " N"], valid: Bool[Array, " N"]) -> Float[Array, ""]:
    """Median of the valid values (the lower of the two middle ones), 0 where there is none."""
    word = _word(values.dtype)
    bits = jax.lax.bitcast_convert_type(jax.lax.stop_gradient(values), word)
    top = jnp.asarray(1, word) << (8 * values.dtype.itemsize - 1)
    # Negative floats are in the reverse order of their bits, and below the others.
    keys = jnp.where(bits & top != 0, ~bits, bits | top)
    ordered = jnp.sort(jnp.where(valid, keys, ~jnp.zeros((), word)))
    count = jnp.sum(valid)
    middle = ordered[jnp.maximum(count - 1, 0) // 2]
    found = jax.lax.bitcast_convert_type(jnp.where(middle & top != 0, middle ^ top, ~middle), values.dtype)
    # The derivative is with respect to the list, so the median is taken from there. The nearest value is: XLA
    # may compute the list twice, with other rounding, and then none is equal.
    off = jnp.where(valid, jnp.abs(jax.lax.stop_gradient(values) - found), jnp.inf)
    return jnp.where(count > 0, values[jnp.argmin(off)], 0)


def _word(dtype: jnp.dtype) -> type:
    """Unsigned integer type of the same width."""
    return jnp.uint32 if dtype.itemsize == 4 else jnp.uint64
