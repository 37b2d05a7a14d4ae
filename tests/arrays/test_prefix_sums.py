"""Prefix sums: exact, at any length."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import prefix_sums


@pytest.mark.parametrize("count", [1, 127, 128, 129, 5000])
def test_sums_are_exact(rng, count):
    counts = rng.integers(0, 2**16, count)
    found = prefix_sums(jnp.asarray(counts, jnp.int32))
    assert found.dtype == jnp.int32
    np.testing.assert_array_equal(found, np.cumsum(counts))
