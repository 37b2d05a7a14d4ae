"""Normalised squared errors of poses that err as their covariances say, and of poses that don't."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation import nees
from sfgs_jax.geometry import Trajectory, se3

COUNT = 2000


@pytest.fixture(scope="module")
def drawn():
    """Poses with errors drawn from their covariances, and the truth in a world of its own."""
    rng = np.random.default_rng(5)
    poses = se3.to_matrices(se3.exp(jnp.asarray(rng.normal(size=(COUNT, 6)), jnp.float32)))
    roots = np.repeat([0.01, 0.005], 3)[:, None] * rng.normal(size=(COUNT, 6, 6))
    errors = np.einsum("nij,nj->ni", roots, rng.normal(size=(COUNT, 6)))
    errors[0] = 0
    off = se3.to_matrices(se3.exp(jnp.asarray(errors, jnp.float32)))
    world = se3.to_matrices(se3.exp(jnp.ones((1, 6))))
    times = np.arange(COUNT) / 30
    return Trajectory(times, poses), roots @ np.swapaxes(roots, 1, 2), Trajectory(times, world @ poses @ off)


def test_right_covariances_make_six(drawn):
    found = nees(*drawn)
    assert len(found.squares) == COUNT - 1
    assert found.mean == pytest.approx(6, abs=0.4)
    assert found.share_within(3.0) == pytest.approx(0.9973, abs=0.004)
    assert found.share_within(1.0) == pytest.approx(0.6827, abs=0.04)


def test_wrong_covariances_are_told(drawn):
    estimate, covariances, truth = drawn
    assert nees(estimate, 4 * covariances, truth).mean == pytest.approx(1.5, abs=0.1)
    sure = nees(estimate, covariances / 9, truth)
    assert sure.mean == pytest.approx(54, abs=4)
    assert sure.share_within(3.0) < 0.3


def test_covariances_stay_with_their_poses(drawn):
    """The estimate comes out of order and has a pose without truth."""
    estimate, covariances, truth = drawn
    order = np.concatenate([[0], 1 + np.random.default_rng(0).permutation(COUNT - 1)])
    shuffled = nees(estimate[order], covariances[order], truth[np.arange(COUNT) != 7])
    whole = np.delete(nees(estimate, covariances, truth).squares, 6)
    np.testing.assert_allclose(shuffled.squares, whole, rtol=1e-9)


def test_another_clock_is_refused(drawn):
    estimate, covariances, truth = drawn
    with pytest.raises(InputError, match="same clock"):
        nees(estimate, covariances, Trajectory(truth.timestamps + 1e4, truth.poses))
