"""A small room and settings for it, shared by the tests of this folder.

Compiling is most of what these tests cost, and settings are static. A test with settings of its own, or with
images of another size, compiles `track` and `register` once more. So where a test wants to provoke something,
it does so by its frames if it can.
"""

from dataclasses import replace

import pytest

from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import FeaturesConfig, GraphConfig, MappingConfig, SlamConfig, TrackingConfig


@pytest.fixture(scope="session")
def room():
    """Twelve frames of the synthetic room at 160 x 120, and their camera and poses."""
    return SyntheticRecording(num_frames=12, width=160, height=120)


@pytest.fixture(scope="session")
def frames(room):
    """The frames, decoded once."""
    return [room[i] for i in range(len(room))]


@pytest.fixture(scope="session")
def config() -> SlamConfig:
    """Capacities that suit the small room, and keyframes within a few frames of it."""
    gicp = GicpConfig()
    # One level is enough for so small an image, and compiles in a third of the time.
    gicp = replace(gicp, levels=1, strides=(1,))
    return SlamConfig(
        tracking=TrackingConfig(
            features=FeaturesConfig(max_keypoints=256, max_rigid_matches=128),
            gicp=gicp,
            keyframe_translation=0.03,
        ),
        graph=GraphConfig(capacity=16, max_landmarks=128, window=4),
        mapping=replace(MappingConfig(), capacity=16_384, pair_capacity=32_768, final_steps=2),
    )
