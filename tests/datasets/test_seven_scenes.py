"""7-Scenes sequences: registration of depth, poses of the colour camera."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording
from sfgs_jax.datasets.layouts.seven_scenes import T_COLOUR_DEPTH


@pytest.fixture
def scene(tmp_path, write_image, images):
    """Writes frames 3 and 4 of a wall 2 m in front of the depth camera, and a broken pose."""
    folder = tmp_path / "wall" / "seq-01"
    for n in (3, 4):
        rgb, _ = images(640, 480)
        depth = np.full((480, 640), 2000, np.uint16)
        depth[:, 600:] = 65535
        write_image(folder / f"frame-{n:06d}.color.png", rgb)
        write_image(folder / f"frame-{n:06d}.depth.png", depth)
        pose = np.eye(4)
        pose[:3, 3] = [n, 0, 0]
        np.savetxt(folder / f"frame-{n:06d}.pose.txt", pose if n == 3 else np.full((4, 4), -np.inf))
    return folder


def test_depth_is_the_colour_cameras(scene):
    recording = open_recording(scene)
    assert recording.dataset == "7scenes"
    np.testing.assert_allclose(recording.timestamps, [0.1, 4 / 30])
    frame = recording[0]
    depth = np.asarray(frame.depth, np.float64)
    # A plane n·x = 2 of the depth camera, along the rays of the colour camera.
    rotation, translation = T_COLOUR_DEPTH[:3, :3], T_COLOUR_DEPTH[:3, 3]
    normal = rotation[:, 2]
    rays = np.asarray(recording.camera.unproject(recording.camera.pixels(), jnp.ones((480, 640))))
    expected = (2 + normal @ translation) / (rays @ normal)
    covered = depth > 0
    np.testing.assert_allclose(depth[covered], expected[covered], atol=2e-4)
    # The wall fills the depth image's width but for 40 saturated columns, drawn 525/585 as wide.
    assert covered[240].sum() == pytest.approx(600 * 525 / 585, abs=2)


def test_poses_are_the_colour_cameras(scene):
    recording = open_recording(scene)
    truth = recording.ground_truth
    assert truth is not None
    assert len(truth) == 1
    np.testing.assert_allclose(truth.poses[0, :3, 3] - [3, 0, 0], np.linalg.inv(T_COLOUR_DEPTH)[:3, 3])
    assert recording.notes == ("1 ground-truth pose is not finite and ignored.",)


def test_folder_above_the_sequences_asks_for_one(scene):
    with pytest.raises(InputError, match="Did you mean one of the recordings inside it: seq-01"):
        open_recording(scene.parent)
    with pytest.raises(InputError, match="no 7scenes recording"):
        open_recording(scene.parent, dataset="7scenes")


def test_frame_of_another_size_is_a_frame_error(scene, write_image, images):
    rgb, depth = images(64, 48)
    write_image(scene / "frame-000004.color.png", rgb)
    write_image(scene / "frame-000004.depth.png", depth)
    recording = open_recording(scene)
    recording[0]
    with pytest.raises(FrameError, match="64x48"):
        recording[1]


def test_missing_depth_image_is_a_frame_error(scene):
    (scene / "frame-000004.depth.png").unlink()
    with pytest.raises(FrameError, match="No such file"):
        open_recording(scene)[1]
