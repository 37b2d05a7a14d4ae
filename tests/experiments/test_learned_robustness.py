"""Learned robustness in miniature: slopes of finite differences, and wrong matches narrow the kernel."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from experiments.learned_robustness import config_of, stacked
from experiments.robust_registration import NAMES, by_hand, error, frame_pair
from sfgs_jax import gicp, slam
from sfgs_jax.datasets import SyntheticRecording

TRACKING = slam.TrackingConfig(
    features=slam.FeaturesConfig(max_keypoints=64),
    gicp=gicp.GicpConfig(levels=1, strides=(1,), skipped_halvings=0),
)


@pytest.fixture(autouse=True)
def _numpy_promotion():
    """The experiment mixes ranks freely, which the tests' strict promotion refuses."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@pytest.fixture(scope="module")
def pair():
    """Two frames of which a third of the matches is moved by 4 pixels."""
    recording = SyntheticRecording(num_frames=60, width=80, height=60)
    poses, params = recording.ground_truth.poses, slam.tracker_params(recording.camera, TRACKING)
    truth, off = np.linalg.inv(poses[0]) @ poses[3], np.full(6, 0.01)
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        made = frame_pair(params, recording[3], recording[0], truth, off)
    wrong = np.arange(len(made.matched)) % 3 == 0
    moved = jnp.asarray(made.pixels + 4.0 * wrong[:, None] * np.asarray([[1.0, 0.0]]), jnp.float32)
    return made._replace(pixels=moved)


def test_the_error_has_the_slopes_of_finite_differences(pair):
    value_and_slope = jax.jit(jax.value_and_grad(lambda r: jnp.log(error(r, pair))))
    value, slope = value_and_slope(by_hand())
    assert np.exp(value) < 0.02
    assert set(NAMES) == set(vars(slope))
    # Wrong matches pull less through a narrower kernel, and with less weight.
    assert slope.keypoint_width > 0 > slope.correlation
    steps = jax.tree.map(lambda s: 0.05 * jnp.sign(s), slope)
    up, down = (jax.tree.map(lambda r, s, d=d: r + d * s, by_hand(), steps) for d in (1, -1))
    rise = value_and_slope(up)[0] - value_and_slope(down)[0]
    predicted = 0.1 * sum(abs(float(s)) for s in jax.tree.leaves(slope))
    np.testing.assert_allclose(rise, predicted, rtol=0.4)


def test_the_numbers_by_hand_are_the_tracker_s(pair):
    config = config_of(by_hand())
    np.testing.assert_allclose(config.features.kernel_width, TRACKING.features.kernel_width, rtol=1e-6)
    np.testing.assert_allclose(config.features.correlation, TRACKING.features.correlation, rtol=1e-6)
    np.testing.assert_allclose(config.gicp.kernel_width, TRACKING.gicp.kernel_width, rtol=1e-6)
    np.testing.assert_allclose(config.motion_model_sigma, TRACKING.motion_model_sigma, rtol=1e-6)


def test_pairs_are_stacked(pair):
    both = stacked([pair, pair])
    assert both.points.shape == (2, *pair.points.shape)
    assert both.camera.fx.shape == (2,)
