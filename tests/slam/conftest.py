"""A small room and settings for it, shared by the tests of this folder."""

from dataclasses import replace

import pytest

from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import FeaturesConfig, GraphConfig, MappingConfig, SlamConfig, TrackingConfig


@pytest.fixture(scope="session")
def room():
    """Twelve frames of the synthetic room at 128 x 96, and their camera and poses."""
    return SyntheticRecording(num_frames=12, width=128, height=96)


@pytest.fixture(scope="session")
def frames(room):
    """The frames, decoded once."""
    return [room[i] for i in range(len(room))]


@pytest.fixture(scope="session")
def config() -> SlamConfig:
    """Capacities that suit the small room."""
    return SlamConfig(
        tracking=TrackingConfig(
            features=FeaturesConfig(max_keypoints=256, max_rigid_matches=128),
            gicp=GicpConfig(strides=(1, 1, 1, 1)),
        ),
        graph=GraphConfig(capacity=16, max_landmarks=128, window=4),
        mapping=replace(MappingConfig(), capacity=8192, pair_capacity=32_768, final_steps=2),
    )
