"""transforms.json with depth: cameras with OpenGL's axes, principal points from the corner."""

import json

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import open_recording


@pytest.fixture
def scene(tmp_path, room, capture, write_image):
    """A folder with images, and the content of its transforms.json, out of order."""
    folder = tmp_path / "desk"
    frames = []
    for n, frame in enumerate(capture):
        write_image(folder / f"images/frame_{n}.png", frame.rgb)
        write_image(folder / f"depth/frame_{n}.png", np.round(frame.depth * 1000).astype(np.uint16))
        frames.append(
            {
                "file_path": f"./images/frame_{n}.png",
                "depth_file_path": f"depth/frame_{n}.png",
                "transform_matrix": (frame.pose @ np.diag([1, -1, -1, 1])).tolist(),
            }
        )
    camera = room.camera
    content = {
        "fl_x": float(camera.fx),
        "fl_y": float(camera.fy),
        "cx": float(camera.cx) + 0.5,
        "cy": float(camera.cy) + 0.5,
        "w": room.width,
        "h": room.height,
        "camera_model": "OPENCV",
        "k1": 0.0,
        "frames": frames[::-1],
    }
    return folder, content


def _open(scene, **changes):
    folder, content = scene
    changed = {key: value for key, value in {**content, **changes}.items() if value is not None}
    (folder / "transforms.json").write_text(json.dumps(changed))
    return open_recording(folder)


def _frames(scene, **changes) -> list[dict]:
    return [{**frame, **changes} for frame in scene[1]["frames"]]


def test_images_poses_and_intrinsics(scene, check_capture):
    recording = _open(scene)
    check_capture(recording, dataset="nerfstudio")
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 30)


def test_intrinsics_of_each_frame(scene, check_capture):
    keys = ("fl_x", "fl_y", "cx", "cy", "w", "h")
    frames = _frames(scene, **{key: scene[1][key] for key in keys})
    check_capture(_open(scene, frames=frames, **dict.fromkeys(keys)), dataset="nerfstudio")
    frames[1]["fl_x"] *= 1.01
    recording = _open(scene, frames=frames)
    assert float(recording.camera.fx) == pytest.approx(scene[1]["fl_x"])
    assert "differ by up to 1.0 % between frames" in recording.notes[0]
    frames[1]["fl_x"] *= 1.1
    with pytest.raises(InputError, match="several cameras"):
        _open(scene, frames=frames)


def test_time_stamps_give_the_order(scene, capture):
    frames = scene[1]["frames"]
    for n, frame in enumerate(frames):
        frame["timestamp"] = 100 + n
    recording = _open(scene)
    assert recording.timestamps.tolist() == [100, 101, 102, 103, 104]
    assert np.abs(recording[0].rgb - capture[4].rgb / 255).max() < 0.01
    assert not any("time stamp" in note for note in recording.notes)


def test_time_stamps_of_no_use_are_noted(scene):
    frames = scene[1]["frames"]
    for n, frame in enumerate(frames):
        frame["timestamp"] = None if n == 2 else 100 + n
    recording = _open(scene)
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 30)
    assert any("time stamp of its own" in note for note in recording.notes)


def test_depth_in_units_of_instant_ngp(scene, check_capture):
    frames = [{**frame, "depth_path": frame.pop("depth_file_path")} for frame in _frames(scene)]
    check_capture(_open(scene, frames=frames, integer_depth_scale=0.001), dataset="nerfstudio")
    assert "median depth" in _open(scene, frames=frames, integer_depth_scale=1.0).notes[0]


def test_field_of_view_instead_of_a_focal_length(scene):
    width, focal = scene[1]["w"], scene[1]["fl_x"]
    angle = 2 * np.arctan(width / 2 / focal)
    camera = _open(scene, fl_x=None, fl_y=None, cx=None, camera_angle_x=angle).camera
    assert float(camera.fx) == float(camera.fy) == pytest.approx(focal, rel=1e-6)
    assert float(camera.cx) == width / 2 - 0.5


def test_the_lens_is_taken_out(scene):
    recording = _open(scene, k1=0.2)
    assert recording[0].depth[0, 0] == 0
    assert recording[0].depth[30, 40] > 0


def test_frames_without_depth_or_pose(scene):
    frames = _frames(scene)
    del frames[0]["depth_file_path"], frames[2]["transform_matrix"]
    recording = _open(scene, frames=frames)
    assert len(recording) == 4
    assert recording.notes == (
        "1 of 5 frames have no depth image and are left out.",
        "1 of 4 frames have no ground-truth pose.",
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frames": None}, "list 'frames'"),
        ({"frames": [{"x": 1}]}, "list 'frames'"),
        ({"frames": [{"file_path": "images/frame_0.png"}]}, "no depth_file_path"),
        ({"frames": [{"file_path": "../a.png", "depth_file_path": "d.png"}]}, r"'\.\./a\.png'.* outside"),
        ({"frames": [{"file_path": "a.png", "depth_file_path": "b/../../d.png"}]}, "outside"),
        ({"frames": [{"file_path": ".", "depth_file_path": "d.png"}]}, "is no file"),
        ({"frames": [{"file_path": "a\0.png", "depth_file_path": "d.png"}]}, "is no file"),
        ({"w": float("inf")}, "lacks the intrinsics"),
        ({"frames": [{"file_path": "/etc/a.png", "depth_file_path": "d.png"}]}, "outside"),
        ({"camera_model": "OPENCV_FISHEYE"}, "model OPENCV_FISHEYE can't be read"),
        ({"k4": 0.1}, "k4 can't be used"),
        ({"w": None}, "lacks the intrinsics"),
        ({"fl_x": "wide"}, "lacks the intrinsics"),
        ({"fl_x": float("nan")}, "focal lengths"),
        ({"fl_x": 0}, "focal lengths"),
        ({"w": 640, "h": 480}, "are for 640x480 images"),
        ({"integer_depth_scale": 0}, "integer_depth_scale must be a positive number"),
    ],
)
def test_content_that_cannot_be_used(scene, changes, message):
    with pytest.raises(InputError, match=message) as caught:
        _open(scene, **changes)
    assert len(str(caught.value).splitlines()) == 1


def test_a_pose_that_is_no_matrix(scene):
    with pytest.raises(InputError, match="should be a 4x4 matrix"):
        _open(scene, frames=_frames(scene, transform_matrix=[1, 2, 3]))
    bent = _open(scene, frames=_frames(scene, transform_matrix=(2 * np.eye(4)).tolist()))
    assert bent.ground_truth is None
    assert bent.notes == ("5 ground-truth poses are not finite and ignored.",)


@pytest.mark.parametrize("text", ["{", "[1]", "[" * 100_000, '{"w": ' + "9" * 5000 + "}"])
def test_a_file_that_is_no_object(scene, text):
    folder, _ = scene
    (folder / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=r"transforms\.json (is not valid JSON|should hold one JSON object)"):
        open_recording(folder)
