"""The figures that the limit on wrong focal lengths lies between."""

from dataclasses import replace

import numpy as np

from experiments.focal_lengths import told
from experiments.starts import InMemory
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import FeaturesConfig, GraphConfig, SlamConfig, TrackingConfig


def test_keyframes_tell_focal_lengths_that_are_too_long():
    config = SlamConfig(
        tracking=TrackingConfig(
            features=FeaturesConfig(max_keypoints=256, max_rigid_matches=128),
            gicp=replace(GicpConfig(), levels=1, strides=(1,)),
            keyframe_translation=0.03,
        ),
        graph=GraphConfig(capacity=16, max_landmarks=128, window=4),
    )
    found = told(InMemory(SyntheticRecording(num_frames=12, width=160, height=120)), 0.1, config, [0.0, 1.0])
    assert found.tracked == 12
    assert np.isinf(found.sigmas[0])
    assert found.estimates[0] == 0
    assert -0.2 < found.estimates[-1] < -0.02
    assert abs(found.estimates[-1] + np.log(1.1)) < 3 * found.sigmas[-1]
    assert np.all((found.sure == 0) | (found.sure == abs(found.estimates)))
    np.testing.assert_array_equal(found.beyond[:, 0], found.sure > 0)
    assert not found.beyond[:, 1].any()
