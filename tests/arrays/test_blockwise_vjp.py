"""Gradients over blocks of rows: the same as over all rows at once."""

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
    columns = [jnp.asarray(rng.uniform(1, 2, count), jnp.float32) for _ in range(2)]
    weights = [jnp.asarray(rng.normal(size=count), jnp.float32) for _ in range(2)]
    rows = [jnp.where(used, column, jnp.nan) for column in columns]

    def total(function, rows, shared):
        (first, second), _ = function(rows, jnp.asarray(used), shared)
        return jnp.sum(jnp.where(used, first * weights[0] + second * weights[1], 0))

    shared = jnp.float32(0.7)
    found, by_shared = jax.grad(lambda r, s: total(lambda *a: map_used_rows(wave, *a), r, s), (0, 1))(
        rows, shared
    )
    expected, by_shared_expected = jax.grad(lambda r, s: total(wave, r, s), (0, 1))(rows, shared)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(by_shared, by_shared_expected, rtol=1e-4, atol=1e-3)
