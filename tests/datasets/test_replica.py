"""Replica rooms in NICE-SLAM's layout; what the writer covers is in test_writers."""

import json

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import open_recording


@pytest.fixture
def office(tmp_path, write_image, images):
    folder = tmp_path / "Replica" / "office0"
    for n in (0, 1, 3):
        rgb, depth = images(1200, 680)
        depth[0, 0] = 13107
        write_image(folder / "results" / f"frame{n:06d}.jpg", rgb)
        write_image(folder / "results" / f"depth{n:06d}.png", depth)
    rows = np.tile(np.eye(4), (4, 1, 1))
    rows[:, 0, 3] = range(4)
    np.savetxt(folder / "traj.txt", rows.reshape(4, 16))
    return folder


def test_published_rooms(office):
    recording = open_recording(office)
    assert recording.dataset == "replica"
    camera = recording.camera
    assert [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)] == [600, 600, 599.5, 339.5]
    assert float(np.asarray(recording[0].depth)[0, 0]) == pytest.approx(2.0)
    # Lines of traj.txt go with the images' numbers, so a frame that was taken away shifts nothing.
    np.testing.assert_allclose(recording.timestamps, np.array([0, 1, 3]) / 30)
    np.testing.assert_allclose(recording.ground_truth.positions[:, 0], [0, 1, 3])


def test_camera_file_above_the_room(office):
    camera = {"w": 1200, "h": 680, "fx": 610.0, "fy": 611.0, "cx": 600.0, "cy": 340.0, "scale": 1000.0}
    (office.parent / "cam_params.json").write_text(json.dumps({"camera": camera}))
    recording = open_recording(office)
    assert float(recording.camera.fy) == 611
    assert float(np.asarray(recording[0].depth)[0, 0]) == pytest.approx(13.107)


def test_camera_file_that_lacks_numbers_is_refused(office):
    (office / "cam_params.json").write_text('{"camera": {"w": 1200}}')
    with pytest.raises(InputError, match=r"cam_params\.json"):
        open_recording(office)
