"""Learning through the tracker in miniature: a window's error falls, and detection stays as it is."""

import equinox as eqx
import jax
import numpy as np
import pytest

from experiments.learn_through_slam import bounded, change, train, trained_parts
from experiments.tracked_windows import image_loss, pose_loss, tracking, windows_of
from sfgs_jax.superfeats import load_weights

CONFIG = tracking(use_surface=False, learned_weights=True)


@pytest.fixture(autouse=True)
def _numpy_promotion():
    """The experiment mixes ranks freely, which the tests' strict promotion refuses."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="module")
def windows():
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        return windows_of("room", seed=0, count=1, width=96)


def test_training_by_poses_lowers_their_error_and_leaves_detection(windows):
    shipped = load_weights()
    network, losses = train(pose_loss, windows, seed=0, config=CONFIG, steps=12, rate=1e-4)
    assert min(losses[6:]) < losses[0] - 0.02
    moved = jax.tree.map(lambda a, b: bool(np.any(np.asarray(a) != np.asarray(b))), network, shipped)
    parts = trained_parts(shipped)
    assert all((moved.describe.weight, moved.rely.weight, moved.levels[0].reduce.weight))
    assert not any(jax.tree.leaves(eqx.filter(moved, jax.tree.map(lambda part: not part, parts))))


def test_the_image_s_error_is_least_at_the_true_poses(windows, monkeypatch):
    (window,) = windows
    monkeypatch.setattr("experiments.tracked_windows.tracked", lambda params, w: params)
    shifts = [window.poses[1:].at[:, 4].add(x) for x in (0.0, 0.03, 0.1)]
    none, small, large = (float(image_loss(poses, window)) for poses in shifts)
    assert none < small < large


def test_a_gradient_that_is_not_finite_counts_as_none():
    network = load_weights()
    ones, bound = jax.tree.map(np.ones_like, network), jax.jit(bounded)
    length = np.sqrt(sum(np.sum(np.square(x)) for x in jax.tree.leaves(bound(ones))))
    np.testing.assert_allclose(length, 1, rtol=1e-4)
    broken = eqx.tree_at(lambda n: n.rely.bias, ones, np.full_like(ones.rely.bias, np.nan))
    assert not any(np.any(x) for x in jax.tree.leaves(bound(broken)))


def test_the_error_of_a_change_counts_blocks_of_time_and_seeds():
    before, spread = np.zeros(24), np.repeat([0.1, -0.1] * 6, 2)
    after = np.log(0.9) + np.stack([spread, spread])
    # Twelve blocks of two equal windows.
    assert change(after, before) == f"-10.0 ± {90 * 0.1 / np.sqrt(11):.1f}"
    apart = after + np.asarray([[0.2], [-0.2]])
    assert change(apart, before) == f"-10.0 ± {90 * np.hypot(0.1 / np.sqrt(11), 0.2):.1f}"
