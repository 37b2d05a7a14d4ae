"""A wall of tiles, each like its neighbour: a camera that goes along it is not put a tile aside.

Tiles are a metre wide, and from one of these frames to the next the camera moves by up to 28 cm.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import datasets, slam
from sfgs_jax.geometry import downscale_depth, downscale_rgb, se3

FRAMES = range(188, 99, -2)
"""Every second frame of the half that shows the wall, backwards."""


@pytest.fixture(scope="module")
def infos(sfgs_data):
    recording = datasets.open_recording(str(sfgs_data / "data/tartanair/hospital_clip"))
    state = slam.init(recording.camera.downscaled(2), slam.SlamConfig())
    found = []
    for i, number in enumerate(FRAMES):
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
    return found, recording.ground_truth.poses[list(FRAMES)]


def test_no_frame_is_lost_or_in_another_map(infos):
    found, _ = infos
    assert all(info.tracked for info in found)
    assert not any(info.new_map for info in found[1:])


def test_no_frame_is_a_tile_off(infos):
    found, truth = infos
    poses = np.stack([np.asarray(se3.matrix(info.T_world_cam)) for info in found])
    placed = truth[0] @ np.linalg.inv(poses[0]) @ poses
    assert np.linalg.norm((placed - truth)[:, :3, 3], axis=1).max() < 0.2
