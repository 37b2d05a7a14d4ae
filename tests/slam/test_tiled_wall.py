"""A wall of tiles, each like its neighbour: a camera that goes along it, or jumps, is not put a tile aside.

Tiles are a metre wide, and from one of the frames backwards to the next the camera moves by up to 28 cm.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import datasets, slam
from sfgs_jax.geometry import downscale_depth, downscale_rgb, se3

BACKWARDS = tuple(range(188, 99, -2))
"""Every second frame of the half that shows the wall."""


@pytest.fixture(scope="module")
def recording(sfgs_data):
    return datasets.open_recording(str(sfgs_data / "data/tartanair/hospital_clip"))


def followed(recording, numbers):
    """What becomes of frames, and how far off those are that are tracked, metres."""
    state = slam.init(recording.camera.downscaled(2), slam.SlamConfig())
    found = []
    for i, number in enumerate(numbers):
        frame = recording[number]
        small = replace(
            frame,
            rgb=np.asarray(downscale_rgb(jnp.asarray(frame.rgb), 2)),
            depth=np.asarray(downscale_depth(jnp.asarray(frame.depth), 2)),
            timestamp=i / 15,
            depth_timestamp=None,
        )
        state, info, _ = slam.follow(state, small)
        found.append(info)
    truth = recording.ground_truth.poses[list(numbers)]
    poses = np.stack([np.asarray(se3.matrix(info.T_world_cam)) for info in found])
    placed = truth[0] @ np.linalg.inv(poses[0]) @ poses
    off = np.linalg.norm((placed - truth)[:, :3, 3], axis=1)
    return found, off[[info.tracked for info in found]]


@pytest.fixture(scope="module")
def backwards(recording):
    return followed(recording, BACKWARDS)


def test_no_frame_is_lost_or_in_another_map(backwards):
    found, _ = backwards
    assert all(info.tracked for info in found)
    assert not any(info.new_map for info in found[1:])


def test_no_frame_is_a_tile_off(backwards):
    assert backwards[1].max() < 0.2


def jumped(recording, number, by):
    """How far off frames are that are tracked, metres, and how many: five before a jump and four after it."""
    _, off = followed(recording, (*range(number - 5, number), *range(number + by, number + by + 4)))
    return off.max(), len(off)


@pytest.mark.parametrize(
    ("number", "by"), [(10, 14), (66, 10), (74, -14), (66, -20), (106, -20), (122, -10), (42, 20)]
)
def test_a_camera_that_jumps_out_of_view_is_lost_rather_than_a_tile_off(recording, number, by):
    """By a metre or more."""
    worst, tracked = jumped(recording, number, by)
    assert worst < 0.1
    assert tracked >= 5


@pytest.mark.parametrize("number", [58, 66])
def test_a_camera_that_is_put_back_is_found_at_once(recording, number):
    worst, tracked = jumped(recording, number, -10)
    assert worst < 0.1
    assert tracked == 9
