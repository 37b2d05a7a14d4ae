"""Sorting by several keys that carry an index along, in one pass.

XLA sorts a single array several times faster than pairs of arrays. So keys and index are packed into one
word of 64 bits. Such words exist in here only: what goes in and comes out has 32 bits, whether or not JAX
is set to 64.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt32

_DEPTH_BITS = 31


def sort_by_tile_and_depth(
    tiles: Int[Array, " p"],
    depths: Float[Array, " p"],
    gaussians: Int[Array, " p"],
    *,
    tile_count: int,
    gaussian_count: int,
) -> Int[Array, " p"]:
    """The Gaussians by tile, in a tile by depth in float32, at equal depth by index.

    Args:
        tiles: (P,) from 0 to `tile_count`, that one included.
        depths: (P,) not negative.
        gaussians: (P,) from 0 to `gaussian_count` - 1.
        tile_count: static.
        gaussian_count: static.
    """
    index_bits = gaussian_count.bit_length()
    # More than a word holds takes some 10**5 tiles and 10**6 Gaussians; depths then lose their last bits.
    excess = max(0, tile_count.bit_length() + _DEPTH_BITS + index_bits - 64)
    # The bits of a float that is not negative sort as it does.
    bits = jax.lax.bitcast_convert_type(jnp.maximum(depths, 0).astype(jnp.float32), jnp.uint32)
    return _sorted_payload(
        [(tiles, 32), (bits >> np.uint32(excess), _DEPTH_BITS - excess)], gaussians, index_bits
    )


def stable_argsort(keys: UInt32[Array, " n"]) -> Int[Array, " n"]:
    """Positions of `keys` in ascending order, equal ones in the order they have."""
    return _sorted_payload([(keys, 32)], jnp.arange(keys.shape[0], dtype=jnp.int32), 32)


def _sorted_payload(keys: list[tuple[Array, int]], payload: Int[Array, " n"], bits: int) -> Int[Array, " n"]:
    """The payload, of so many bits, by keys (each with its bits), the first first, then by itself."""
    with jax.enable_x64(True):
        words = jnp.zeros(payload.shape, jnp.uint64)
        for values, width in [*keys, (payload, bits)]:
            words = (words << np.uint64(width)) | values.astype(jnp.uint64)
        # The lower half of a word is what a conversion to 32 bits leaves.
        lower = jnp.sort(words).astype(jnp.uint32)
    return (lower & np.uint32(2**bits - 1)).astype(jnp.int32)
