"""Reduced images: exact means, and no point between two surfaces."""

import jax.numpy as jnp
import numpy as np

from sfgs_jax.geometry import downscale_depth, downscale_rgb


def test_colours_are_block_means(rng):
    rgb = rng.random((7, 9, 3)).astype(np.float32)
    small = downscale_rgb(jnp.asarray(rgb), 2)
    assert small.shape == (3, 4, 3)
    np.testing.assert_allclose(small[1, 2], rgb[2:4, 4:6].mean(axis=(0, 1)), rtol=1e-6)


def test_depth_is_the_mean_of_the_nearest_surface():
    blocks = [[1.0, 1.02, 1.01, 0.0], [2.0, 2.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0], [0.0, 3.0, 0.0, 0.0]]
    depth = jnp.concatenate([jnp.asarray(block).reshape(2, 2) for block in blocks], axis=1)
    np.testing.assert_allclose(downscale_depth(depth, 2), [[1.01, 1.0, 0.0, 3.0]], rtol=1e-6)


def test_factor_one_changes_nothing(rng):
    depth = jnp.asarray(rng.random((5, 5)), jnp.float32)
    np.testing.assert_array_equal(downscale_depth(depth, 1), depth)
