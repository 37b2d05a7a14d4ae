"""Design by gradient in miniature: the prediction has the slope of finite differences, and it descends."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.design_by_gradient import (
    BUDGET,
    descent,
    expected,
    expected_and_slope,
    scanned,
    starts,
    within,
)
from sfgs_jax.geometry import se3


@pytest.fixture(autouse=True)
def _numpy_promotion():
    """The experiment mixes ranks freely, which the tests' strict promotion refuses."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="module")
def room():
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        return scanned(seed=0, views=9, planning_width=40)


@pytest.fixture(scope="module")
def start():
    return se3.from_matrix(starts(seed=0, count=2)[1])


def test_the_expected_error_has_the_slope_of_finite_differences(room, start):
    still = jnp.zeros(6)
    args = room.known, room.planning, start
    _, slope = expected_and_slope(*args, still, room.config)
    step = 0.05 * slope / jnp.linalg.norm(slope)
    rise = expected(*args, step, room.config) - expected(*args, -step, room.config)
    np.testing.assert_allclose(rise, 2 * slope @ step, rtol=0.2)


def test_the_descent_finds_a_view_that_tells_more_within_the_budget(room, start):
    best, course = descent(room, start, steps=4)
    assert course[-1] < 0.97 * course[0]
    assert np.all(np.diff(course) <= 0)
    np.testing.assert_allclose(best, within(best), rtol=1e-5)
    assert np.all(np.linalg.norm(best.reshape(2, 3), axis=1) <= 1 + 1e-5)
    # The error that was kept is that of the motion that was kept.
    value = expected(room.known, room.planning, start, jnp.asarray(best), room.config)
    np.testing.assert_allclose(np.exp(value), course[-1], rtol=1e-3)


def test_a_longer_motion_is_cut_to_the_budget():
    far = np.asarray([3.0, 0, 4, 0.1, 0, 0])
    np.testing.assert_allclose(within(far), [0.6, 0, 0.8, 0.1, 0, 0], rtol=1e-6)
    assert BUDGET.shape == (6,)
