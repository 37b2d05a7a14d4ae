"""Stable sorting by 32-bit keys: XLA sorts single arrays of uint32 several times faster than pairs.

So a key is packed into one word with the position it came from, which makes the sort stable and the
position its payload. Where both don't fit, the key is sorted in digits, the lowest first.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32


def stable_argsort(keys: UInt32[Array, " n"], key_bits: int) -> Int[Array, " n"]:
    """Positions of `keys` in ascending order, equal ones in the order they have.

    Args:
        keys: (n,) keys below 2**key_bits.
        key_bits: significant bits, static.
    """
    n = keys.shape[0]
    position_bits = max(n - 1, 1).bit_length()
    passes = -(-key_bits // (32 - position_bits))
    digit_bits = -(-key_bits // passes)
    positions = jnp.arange(n, dtype=jnp.uint32)
    order = None
    for digit in range(passes):
        digits = (keys >> (digit * digit_bits)) & ((1 << digit_bits) - 1)
        digits = digits if order is None else digits[order]
        sorted_words = jnp.sort((digits << position_bits) | positions)
        arrived = (sorted_words & ((1 << position_bits) - 1)).astype(jnp.int32)
        order = arrived if order is None else order[arrived]
    assert order is not None
    return order


def depth_order(depths: Float[Array, " n"], visible: Bool[Array, " n"], near: float, far: float) -> Array:
    """(n,) indices of the visible by ascending depth in float32, equal ones by index; then the others."""
    # The bits of a positive float sort as it does; counted from the nearest they are few.
    lowest, highest = (int(np.float32(value).view(np.uint32)) for value in (near, far))
    bits = jax.lax.bitcast_convert_type(depths.astype(jnp.float32), jnp.uint32)
    last = highest - lowest + 1
    keys = jnp.where(visible, jnp.clip(bits, lowest, highest) - lowest, jnp.uint32(last))
    return stable_argsort(keys, last.bit_length())
