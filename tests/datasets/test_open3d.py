"""Recordings as Open3D's recorders and reconstruction system have them."""

import json

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import open_recording


@pytest.fixture
def desk(tmp_path, room, capture, write_image):
    folder = tmp_path / "desk"
    lines = []
    for n, frame in enumerate(capture):
        write_image(folder / f"color/{n:05d}.png", frame.rgb)
        write_image(folder / f"depth/{n:05d}.png", np.round(room[n].depth * 1000).astype(np.uint16))
        lines += [f"{n} {n} {n + 1}", *(" ".join(map(repr, row)) for row in frame.pose.tolist())]
    (folder / "trajectory.log").write_text("\n".join(lines) + "\n")
    matrix = np.asarray(room.camera.matrix(), float).T.ravel().tolist()
    camera = {"width": room.width, "height": room.height, "intrinsic_matrix": matrix}
    (folder / "intrinsic.json").write_text(json.dumps(camera))
    return folder


def test_images_poses_and_intrinsics(desk, check_capture):
    recording = open_recording(desk)
    check_capture(recording, dataset="open3d", small_depth=False)
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 30)


@pytest.mark.parametrize("colour", ["rgb", "image"])
@pytest.mark.parametrize("camera", ["camera_intrinsic.json", "camera_primesense.json"])
def test_other_names(desk, check_capture, colour, camera):
    (desk / "color").rename(desk / colour)
    (desk / "intrinsic.json").rename(desk / camera)
    (desk / "scene").mkdir()
    (desk / "trajectory.log").rename(desk / "scene/trajectory.log")
    check_capture(open_recording(desk), dataset="open3d", small_depth=False)


def test_poses_of_some_frames(desk, capture):
    lines = (desk / "trajectory.log").read_text().splitlines()
    (desk / "trajectory.log").write_text("\n".join(lines[10:15]))
    recording = open_recording(desk)
    np.testing.assert_allclose(recording.ground_truth.poses, [capture[2].pose], atol=1e-9)
    np.testing.assert_allclose(recording.ground_truth.timestamps, [2 / 30])
    assert recording.notes == ("4 of 5 frames have no ground-truth pose.",)


def test_a_camera_json_of_the_users_own_makes_it_a_plain_folder(desk):
    (desk / "color").rename(desk / "rgb")
    (desk / "camera.json").write_text('{"fx": 60, "fy": 60, "cx": 40, "cy": 30}')
    assert open_recording(desk).dataset == "folder"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("intrinsic.json", "{}", "does not hold width, height"),
        ("intrinsic.json", '{"width": 80, "height": 60, "intrinsic_matrix": [1]}', "has 1 numbers"),
        ("intrinsic.json", '{"width": 80, "height": 60, "intrinsic_matrix": null}', "does not hold width"),
        ("intrinsic.json", "no", "is not valid JSON"),
        ("trajectory.log", "0 0 1\n1 0 0 0\n", "three numbers and a 4x4 matrix"),
        ("trajectory.log", "0 0 x\n", "line 1: expected numbers"),
        ("trajectory.log", "nan 0 1\n" + "1 0 0 0\n" * 4, "begin each frame with its number"),
    ],
)
def test_files_that_cannot_be_used(desk, name, text, message):
    (desk / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_recording(desk)
    assert len(str(caught.value).splitlines()) == 1


def test_depth_that_is_not_registered(desk, capture, write_image):
    for n, frame in enumerate(capture):
        write_image(desk / f"depth/{n:05d}.png", np.round(frame.depth * 1000).astype(np.uint16))
    with pytest.raises(InputError, match="80x60 but depth images are 40x30"):
        open_recording(desk)
