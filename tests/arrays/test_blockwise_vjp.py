"""Gradients over blocks of rows: the same as over all rows at once."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import map_used_rows


def wave(rows, used, shared):
    """A function of rows that is not finite in those not in use unless it heeds `used`."""
    a, b = (jnp.where(used, column, 1) for column in rows)
    return (jnp.sin(a * shared), a / b), used


@pytest.mark.parametrize("count", [0, 1, 65_536, 65_537, 200_000])
def test_gradients_are_those_of_the_rows_in_use(count: int):
    rng = np.random.default_rng(0)
    used = rng.random(count) < 0.5
    used[count // 2 :] = False
    columns = [rng.uniform(1, 2, count).astype(np.float32) for _ in range(2)]
    weights = [rng.normal(size=count).astype(np.float32) for _ in range(2)]
    rows = [np.where(used, column, np.float32(np.nan)) for column in columns]

    @partial(jax.jit, static_argnums=0)
    @partial(jax.grad, argnums=(1, 2))
    def slopes(function, rows, shared):
        (first, second), _ = function(rows, jnp.asarray(used), shared)
        return jnp.sum(jnp.where(used, first * weights[0] + second * weights[1], 0))

    shared = jnp.float32(0.7)
    found, by_shared = slopes(partial(map_used_rows, wave), rows, shared)
    expected, by_shared_expected = slopes(wave, rows, shared)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(by_shared, by_shared_expected, rtol=1e-4, atol=1e-3)
