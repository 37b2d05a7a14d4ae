"""Sorts, minima and medians of packed integers against NumPy."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import arrays
from sfgs_jax.arrays import digit_bits, sort_packed

# One program for each instead of one for each operation.
from_ordered_bits = jax.jit(arrays.from_ordered_bits)
masked_median = jax.jit(arrays.masked_median)
ordered_bits = jax.jit(arrays.ordered_bits)
packed_argmin = jax.jit(arrays.packed_argmin, static_argnames="index_bits")
stable_argsort = jax.jit(arrays.stable_argsort)
stable_order = jax.jit(arrays.stable_order)

NUMBERS = [0.0, 1e-45, 1e-38, 1e-6, 0.5, 1.0, np.nextafter(np.float32(1), 2), 3e38, np.inf, np.nan]


def test_bits_of_numbers_not_below_zero_are_in_their_order():
    values = jnp.asarray(NUMBERS, jnp.float32)
    bits = ordered_bits(values)
    assert bits.dtype == jnp.uint32
    assert np.all(np.diff(np.asarray(bits, np.int64)) > 0)
    assert np.all(np.asarray(bits) < 2**31)
    np.testing.assert_array_equal(from_ordered_bits(bits), values)


def test_bits_in_float64(float64):
    values = jnp.asarray([0.0, 5e-324, 1.0, 1.0 + 2**-52, 1e308, np.inf])
    bits = ordered_bits(values)
    assert bits.dtype == jnp.uint64
    assert np.all(np.diff(np.asarray(bits, np.float64)) >= 0)
    assert len(np.unique(bits)) == len(values)
    np.testing.assert_array_equal(from_ordered_bits(bits), values)


def test_orders_sort_by_the_last_digit_first(rng):
    a, b = rng.integers(0, 50, size=(2, 3000))
    order = stable_order(jnp.asarray(b, jnp.uint32), jnp.asarray(a, jnp.uint32))
    np.testing.assert_array_equal(order, np.lexsort((b, a)))
    assert digit_bits(2**17) == 15


@pytest.mark.parametrize("count", [1, 2, 2**12, 2**12 + 1])
def test_orders_of_the_largest_digits_are_stable(rng, count):
    keys = rng.choice(rng.integers(0, 2 ** digit_bits(count), 7), count)
    keys[0] = 2 ** digit_bits(count) - 1
    order = stable_order(jnp.asarray(keys, jnp.uint32))
    np.testing.assert_array_equal(order, np.argsort(keys, kind="stable"))


def test_packed_sorts_are_by_the_first_key_then_the_next_then_the_payload(rng):
    first, second, payload = rng.integers(0, 2**20, (3, 5000))
    first %= 7
    second = rng.choice(second[:30], 5000)
    found = sort_packed(
        [(jnp.asarray(first, jnp.int32), 3), (jnp.asarray(second, jnp.uint32), 31)],
        jnp.asarray(payload, jnp.int32),
        20,
    )
    assert found.dtype == jnp.int32
    np.testing.assert_array_equal(found, payload[np.lexsort((payload, second, first))])


def test_stable_argsorts_take_keys_of_all_32_bits(rng):
    keys = rng.choice(np.asarray([0, 1, 2**31, 2**32 - 1], np.uint32), 1000)
    np.testing.assert_array_equal(stable_argsort(jnp.asarray(keys)), np.argsort(keys, kind="stable"))


@pytest.mark.parametrize("rows", [1, 2, 9, 32])
def test_packed_minima_are_in_the_row_of_the_least_value(rng, rows):
    # Values apart by more than the bits that their row takes.
    values = np.exp(rng.permuted(np.tile(np.linspace(-30, 30, rows)[:, None], (1, 500)), axis=0))
    found = packed_argmin(jnp.asarray(values, jnp.float32))
    np.testing.assert_array_equal(found, np.argmin(values, axis=0))


def test_packed_minima_prefer_the_first_of_equal_values_and_pass_over_infinity():
    values = jnp.asarray([[jnp.inf, 2.0, 0.0, 1 + 1e-7], [3.0, 2.0, 0.0, 1.0], [4.0, jnp.inf, 1.0, 1.0]])
    np.testing.assert_array_equal(packed_argmin(values), [1, 0, 0, 0])
    np.testing.assert_array_equal(packed_argmin(values, index_bits=8), [1, 0, 0, 0])


def test_packed_minima_are_of_the_values_that_count(rng):
    values = rng.uniform(1, 2, (32, 300)).astype(np.float32)
    where = rng.random((32, 300)) < 0.2
    where[:, 0] = False
    found = packed_argmin(jnp.asarray(values), jnp.asarray(where), index_bits=8)
    assert 0 <= found[0] < 32
    some = where.any(axis=0)
    at_least = np.where(where, values, np.inf).min(axis=0)[some]
    chosen = np.take_along_axis(values, np.asarray(found)[None], axis=0)[0, some]
    assert np.all(np.take_along_axis(where, np.asarray(found)[None], axis=0)[0, some])
    np.testing.assert_allclose(chosen, at_least, rtol=2.0 ** (8 - 23))


def test_the_median_is_of_the_valid_values(rng):
    values = rng.normal(size=1001).astype(np.float32)
    valid = rng.random(1001) < 0.5
    valid[0] = valid.sum() % 2 == 0  # an odd number of them
    found = masked_median(jnp.asarray(values), jnp.asarray(valid))
    assert found == np.sort(values[valid])[(valid.sum() - 1) // 2]
    assert masked_median(jnp.asarray(values), jnp.zeros(1001, bool)) == 0


def test_the_medians_gradient_goes_to_the_value_it_is():
    values = jnp.asarray([3.0, -1.0, 2.0, 7.0, -5.0])
    gradient = jax.grad(lambda v: masked_median(v, jnp.asarray([True, True, True, False, False])))(values)
    np.testing.assert_array_equal(gradient, [0, 0, 1, 0, 0])
