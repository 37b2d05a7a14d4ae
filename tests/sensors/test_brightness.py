"""Change of brightness between two frames of one surface."""

import numpy as np
import pytest

from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import block_means, brightness_change

CHANGE = np.asarray([1.2, 0.9, 1.05])
"""Factor on each channel."""


@pytest.fixture(scope="module")
def recording():
    return SyntheticRecording(num_frames=60, width=320, height=240)


def change_between(recording, first, second, *, factor: float | np.ndarray = 1.0, valid=None):
    """The change as found between two frames, the second one brighter by a factor."""
    a, b = recording[first], recording[second]
    poses = recording.ground_truth.poses
    now = np.clip(np.asarray(b.rgb) * np.float32(factor), 0, 1)
    depth = np.asarray(b.depth)
    valid = np.ones(depth.shape, bool) if valid is None else valid
    T_before_now = np.linalg.inv(poses[first]) @ poses[second]
    looks = block_means(np.asarray(a.rgb)), block_means(now)
    return brightness_change(*looks, depth, valid, recording.camera, T_before_now)


@pytest.mark.parametrize("apart", [1, 8])
def test_the_change_of_each_channel_is_found_while_the_camera_moves(recording, apart):
    found = change_between(recording, 10, 10 + apart, factor=CHANGE)
    np.testing.assert_allclose(np.exp(found), CHANGE, rtol=0.01)


def test_the_moved_image_counts_and_not_the_image_at_the_same_place(recording):
    """The camera turns towards a wall of another colour, and nothing became brighter."""
    first, second = (np.asarray(recording[n].rgb).mean(axis=(0, 1)) for n in (10, 30))
    assert np.abs(np.log(second / first)).max() > 0.05
    np.testing.assert_allclose(change_between(recording, 10, 30), 0, atol=0.02)


def test_what_shares_too_little_or_changes_too_much_changes_nothing(recording):
    nothing = np.zeros(recording.camera.shape, bool)
    np.testing.assert_array_equal(change_between(recording, 10, 11, factor=CHANGE, valid=nothing), 0)
    np.testing.assert_array_equal(change_between(recording, 10, 11, factor=0.0), 0)
    small = np.full((10, 12, 3), 0.5, np.float32)
    camera, depth = Camera(10.0, 10.0, 6.0, 5.0, width=12, height=10), np.ones((10, 12))
    look = block_means(small)
    found = brightness_change(look, look, depth, depth > 0, camera, np.eye(4))
    np.testing.assert_array_equal(found, 0)
