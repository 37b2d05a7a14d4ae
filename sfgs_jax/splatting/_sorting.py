"""The order of drawing: one sort of packed words by tile, depth and index."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import checked, ordered_bits, sort_packed

_DEPTH_BITS = 31
"""Bits of a float32 without its sign."""


@checked
def sort_by_tile_and_depth(
    tiles: Int[Array, " p"],
    depths: Float[Array, " p"],
    gaussians: Int[Array, " p"],
    *,
    tile_count: int,
    gaussian_count: int,
) -> Int[Array, " p"]:
    """Gaussians sorted by tile, within a tile by float32 depth, at equal depth by index.

    Args:
        tiles: (P,) tile of each pair, from 0 to `tile_count`, which stands for no tile.
        depths: (P,) depth of each pair's Gaussian, not negative.
        gaussians: (P,) index of each pair's Gaussian, from 0 to `gaussian_count` - 1.
        tile_count: number of tiles, static.
        gaussian_count: number of Gaussians, static.

    Returns:
        (P,) the indices of the Gaussians, sorted.
    """
    index_bits = gaussian_count.bit_length()
    # With some 10**5 tiles and 10**6 Gaussians a word is too short: depths then lose their last bits.
    excess = max(0, tile_count.bit_length() + _DEPTH_BITS + index_bits - 64)
    bits = ordered_bits(jnp.maximum(depths, 0).astype(jnp.float32))
    return sort_packed(
        [(tiles, 32), (bits >> np.uint32(excess), _DEPTH_BITS - excess)], gaussians, index_bits
    )
