"""Capacities: they hold what they are for, come in few sizes, and waste little."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import bucket, doubled, padded, rounded_up


@pytest.mark.parametrize(("steps", "waste"), [(1, 1.0), (2, 0.5), (4, 0.25), (8, 0.125)])
def test_buckets_hold_the_count_with_bounded_waste_and_steps_sizes_an_octave(steps, waste):
    sizes = [bucket(count, steps=steps) for count in range(4097)]
    assert all(count <= size <= max(count, count * (1 + waste)) for count, size in enumerate(sizes))
    assert sizes == sorted(sizes)
    assert len({size for size in sizes if 1024 < size <= 2048}) == steps
    assert bucket(0, steps=steps) == 0


def test_sizes_worked_out_by_hand():
    two = [bucket(count, steps=2, smallest=1024) for count in (0, 1024, 1025, 1537, 2049, 3073)]
    assert two == [1024, 1024, 1536, 2048, 3072, 4096]
    assert [bucket(count, steps=8) for count in (7, 9, 17, 33, 250)] == [7, 9, 18, 36, 256]
    four = [bucket(count, steps=4, smallest=8, multiple=8) for count in (0, 9, 17, 33, 65, 129)]
    assert four == [8, 16, 24, 40, 80, 160]


def test_doubling_keeps_a_capacity_that_is_enough():
    assert [doubled(6, need) for need in (0, 6, 7, 12, 13, 100)] == [6, 6, 12, 12, 24, 192]


def test_multiples():
    assert [rounded_up(count, 4) for count in (0, 1, 4, 5)] == [0, 4, 4, 8]


def test_padded_rows_keep_what_there_was(rng):
    rows = rng.normal(size=(33, 2)).astype(np.float32)
    found = padded(jnp.asarray(rows))
    assert found.shape == (40, 2)
    np.testing.assert_array_equal(found[:33], rows)
    assert not np.any(found[33:])
    assert padded(jnp.ones(3, bool)).sum() == 3
