"""Times of rows, and points carried from one time to another."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming, carried, row_places, turned, velocities

TWIST = jnp.asarray([0.4, -0.3, 0.5, 0.8, -1.5, 1.0])


@pytest.fixture
def points(rng):
    return jnp.asarray(rng.uniform([[-1], [-1], [1]], [[1], [1], [4]], (3, 50)), jnp.float32)


@pytest.fixture
def times(rng):
    return jnp.asarray(rng.uniform(-0.02, 0.02, 50), jnp.float32)


def test_points_are_carried_like_the_exponential_map_does(points, times):
    T = se3.exp(times[:, None] * TWIST[None])
    exact = jax.vmap(se3.transform)(T, points.T).T
    np.testing.assert_allclose(carried(points, TWIST, times), exact, atol=1e-4)
    # What is not carried is off by a hundred times as much.
    assert float(jnp.max(jnp.abs(points - exact))) > 1e-2
    there = carried(points, TWIST, times)
    np.testing.assert_allclose(carried(there, TWIST, -times), points, atol=2e-4)


def test_directions_turn_and_do_not_move(points, times):
    rotated = jax.vmap(lambda t, p: se3.transform(se3.exp(t * TWIST.at[:3].set(0)), p))(times, points.T).T
    np.testing.assert_allclose(turned(points, TWIST, times), rotated, atol=1e-4)


def test_velocity_is_the_derivative(points):
    zero = jnp.zeros(50)
    _, rate = jax.jvp(lambda times: carried(points, TWIST, times), (zero,), (jnp.ones(50),))
    np.testing.assert_allclose(velocities(points, TWIST), rate, atol=1e-6)


def test_times_of_rows_are_the_same_at_every_resolution():
    timing = SensorTiming(0.01, 0.03, 0.02)
    coarse = jnp.arange(60.0)
    # A coarse row is the middle of its two fine ones.
    np.testing.assert_allclose(
        timing.colour_times(row_places(coarse, 60)),
        timing.colour_times(row_places(2 * coarse + 0.5, 120)),
        atol=1e-8,
    )
    depth = timing.depth_times(row_places(jnp.asarray([-0.5, 29.5, 59.5]), 60))
    np.testing.assert_allclose(depth, [0, 0.01, 0.02], atol=1e-8)


def test_the_vector_has_the_order_of_the_attributes():
    timing = SensorTiming(0.01, 0.03, 0.02)
    np.testing.assert_allclose(timing.vector, [0.01, 0.03, 0.02])
    again = SensorTiming.of_vector(timing.vector)
    assert (again.depth_delay, again.depth_readout) == (timing.depth_delay, timing.depth_readout)


def test_on_the_host_the_times_are_the_same():
    timing = SensorTiming(0.015, 0.03, 0.025)
    np.testing.assert_array_equal(timing.on_host(), timing.vector)
