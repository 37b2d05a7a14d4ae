"""Sorting by 32-bit keys that carry 32 bits along, in one pass.

XLA sorts a single array several times faster than pairs of arrays. So key and payload are packed into one
word of 64 bits. Such words exist in here only: what goes in and comes out has 32 bits, whether or not JAX
is set to 64.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32


def sort_by_key(keys: UInt32[Array, " n"], payload: Int[Array, " n"]) -> Int[Array, " n"]:
    """The payload, not negative, by ascending key; that of equal keys ascending too."""
    with jax.enable_x64(True):
        words = (keys.astype(jnp.uint64) << np.uint64(32)) | payload.astype(jnp.uint64)
        # The lower half of a word is what a conversion to 32 bits leaves.
        return jnp.sort(words).astype(jnp.uint32).astype(jnp.int32)


def stable_argsort(keys: UInt32[Array, " n"]) -> Int[Array, " n"]:
    """Positions of `keys` in ascending order, equal ones in the order they have."""
    return sort_by_key(keys, jnp.arange(keys.shape[0], dtype=jnp.int32))


def depth_order(depths: Float[Array, " n"], visible: Bool[Array, " n"]) -> Int[Array, " n"]:
    """(n,) indices of the visible by ascending depth in float32, equal ones by index; then the others."""
    # The bits of a positive float sort as it does, and are below 2**31.
    bits = jax.lax.bitcast_convert_type(depths.astype(jnp.float32), jnp.uint32)
    return stable_argsort(jnp.where(visible, bits, jnp.uint32(0xFFFFFFFF)))
