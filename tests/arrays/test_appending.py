"""Rows are appended without a copy of all of them, and what was there before stays as it is."""

import numpy as np
import pytest

from sfgs_jax.arrays import appended


@pytest.mark.parametrize("shape", [(), (3,), (6, 6)])
def test_rows_one_by_one_are_the_rows_at_once(shape):
    all_rows = np.random.default_rng(0).normal(size=(300, *shape))
    rows, before = np.zeros((0, *shape), np.float32), []
    for row in all_rows:
        before.append(rows)
        rows = appended(rows, row[None])
    assert rows.dtype == np.float32
    np.testing.assert_array_equal(rows, all_rows.astype(np.float32))
    for count in (0, 1, 64, 65, 299):
        np.testing.assert_array_equal(before[count], rows[:count])


def test_memory_is_taken_a_few_times_and_not_at_each_row():
    rows, places = np.zeros(0), set()
    for number in range(10_000):
        rows = appended(rows, np.asarray([float(number)]))
        places.add(rows.ctypes.data)
    assert len(places) < 20
    assert rows.base.nbytes <= 1.5 * rows.nbytes + 1000


def test_two_ways_to_go_on_from_the_same_rows_do_not_mix():
    common = appended(np.zeros((1, 2)), np.ones((1, 2)))
    one, other = appended(common, np.full((1, 2), 2.0)), appended(common, np.full((2, 2), 3.0))
    assert one[:, 0].tolist() == [0, 1, 2]
    assert other[:, 0].tolist() == [0, 1, 3, 3]
    # A part of the rows is no end that anything may follow.
    assert appended(one[:2], np.full((1, 2), 4.0))[:, 0].tolist() == [0, 1, 4]
    assert one[:, 0].tolist() == [0, 1, 2]
    assert appended(one, np.zeros((0, 2)))[:, 0].tolist() == [0, 1, 2]
