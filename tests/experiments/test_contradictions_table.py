"""The figures that the limits on contradicting depth lie between."""

from dataclasses import replace

import numpy as np
import pytest

from experiments.contradictions import noticed_after, scale_changes, scatter
from experiments.perturbations import PERTURBATIONS
from experiments.starts import InMemory
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import FeaturesConfig, TrackingConfig


@pytest.fixture(scope="module")
def recording():
    return InMemory(SyntheticRecording(num_frames=12, width=160, height=120))


def test_a_change_of_scale_shows_in_the_middle_and_nowhere_else(recording):
    gicp = replace(GicpConfig(), levels=1, strides=(1,))
    features = FeaturesConfig(max_keypoints=256, max_rigid_matches=128)
    config = TrackingConfig(features=features, gicp=gicp, max_scale_change=1e3)
    changed = PERTURBATIONS["change of depth scale"].apply(recording, 5, 0)
    changes = scale_changes(changed, config)
    assert np.isnan(changes[0])
    assert np.abs(changes[1:6]).max() < 0.005
    assert 0.03 < changes[6] < 0.052


@pytest.mark.parametrize("noise", [0.004, 0.02])
def test_scatter_is_the_deviation_of_the_noise(noise, rng):
    depth = 2 + rng.normal(scale=2 * noise, size=(120, 160))
    assert scatter(depth.astype(np.float32)) == pytest.approx(noise, rel=0.06)


def test_too_few_frames_tell_no_lag(recording):
    assert noticed_after(recording, 1) == (None, None)
