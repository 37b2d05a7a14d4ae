"""A small room and a state for it, shared by the tests of this folder."""

from dataclasses import replace

import pytest

from sfgs_jax.datasets import SyntheticRoom
from sfgs_jax.slam import MappingConfig, SlamConfig


@pytest.fixture(scope="session")
def room():
    """Twelve frames of the synthetic room at 96 x 72, and their camera and poses."""
    return SyntheticRoom(num_frames=12, width=96, height=72)


@pytest.fixture(scope="session")
def frames(room):
    """The frames, decoded once."""
    return [room[i] for i in range(len(room))]


@pytest.fixture
def config() -> SlamConfig:
    """Capacities that suit the small room."""
    return SlamConfig(mapping=replace(MappingConfig(), capacity=8192, pair_capacity=32_768, final_steps=2))
