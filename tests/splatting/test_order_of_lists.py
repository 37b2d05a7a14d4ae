"""The order in which a tile's Gaussians are drawn, with indices and tiles of any number of bits."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.splatting import sort_by_tile_and_depth


@pytest.mark.parametrize(
    ("tiles", "gaussians"), [(1, 1), (4800, 50_000), (4800, 1_000_000), (200_000, 4_000_000)]
)
def test_lists_are_by_tile_then_depth_then_index(tiles: int, gaussians: int):
    rng = np.random.default_rng(0)
    tile = rng.integers(0, min(tiles, 40) + 1, 2000) * (tiles // min(tiles, 40))
    index = rng.integers(0, gaussians, 2000)
    # Depths that differ by 1e-5 of themselves at the least, some of them equal, from 1 mm to 10 km.
    depth = 1e-3 * np.exp(1e-5 * rng.choice(1_611_800, 300))[rng.integers(0, 300, 2000)]
    found = sort_by_tile_and_depth(
        jnp.asarray(tile, jnp.int32),
        jnp.asarray(depth, jnp.float32),
        jnp.asarray(index, jnp.int32),
        tile_count=tiles,
        gaussian_count=gaussians,
    )
    np.testing.assert_array_equal(found, index[np.lexsort((index, depth, tile))])
