"""The iPhone's part of ScanNet++ scenes."""

import json

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import open_recording


@pytest.fixture
def scene(tmp_path, room, capture, write_image):
    """A scene's folder, with frames 0, 10, ..., and the content of its metadata."""
    folder = tmp_path / "0a5c013435/iphone"
    matrix = np.asarray(room.camera.matrix(), float).tolist()
    entries = {}
    for i, frame in enumerate(capture):
        name = f"frame_{10 * i:06d}"
        write_image(folder / f"rgb/{name}.png", frame.rgb)
        write_image(folder / f"depth/{name}.png", np.round(frame.depth * 1000).astype(np.uint16))
        entries[name] = {
            "timestamp": 500 + i / 6,
            "pose": np.eye(4).tolist(),
            "aligned_pose": frame.pose.tolist(),
            "intrinsic": matrix,
        }
    entries["frame_000001"] = entries["frame_000000"]
    (folder / "pose_intrinsic_imu.json").write_text(json.dumps(entries))
    return folder.parent, entries


def _write(scene, entries) -> None:
    (scene[0] / "iphone/pose_intrinsic_imu.json").write_text(json.dumps(entries))


@pytest.mark.parametrize("inside", ["", "iphone"])
def test_images_poses_and_intrinsics(scene, check_capture, inside):
    recording = open_recording(scene[0] / inside)
    check_capture(recording, dataset="scannetpp")
    assert recording.name == "0a5c013435"
    np.testing.assert_allclose(recording.timestamps, 500 + np.arange(5) / 6)


def test_colour_from_the_video(scene, capture, check_capture, write_video):
    folder = scene[0] / "iphone"
    for path in (folder / "rgb").iterdir():
        path.unlink()
    write_video(folder / "rgb.mkv", [capture[i // 10].rgb for i in range(41)])
    check_capture(open_recording(scene[0]), dataset="scannetpp")


def test_frames_that_lack_something(scene):
    folder, entries = scene
    (folder / "iphone/rgb/frame_000010.png").unlink()
    (folder / "iphone/depth/frame_000020.png").unlink()
    del entries["frame_000030"]["aligned_pose"], entries["frame_000040"]
    _write(scene, entries)
    recording = open_recording(folder)
    np.testing.assert_allclose(recording.timestamps, [500, 500.5])
    np.testing.assert_allclose(recording.ground_truth.poses[1], np.eye(4))
    assert recording.notes == ("2 of 4 depth images have no colour or no entry in pose_intrinsic_imu.json.",)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"timestamp": "late"}, "timestamp of a frame should be a finite number"),
        ({"timestamp": 1}, "do not increase"),
        ({"timestamp": float("nan")}, "timestamp of a frame should be a finite number"),
        ({"intrinsic": [1, 2]}, "intrinsic of a frame should be a 3x3 matrix"),
        ({"intrinsic": None}, "intrinsic of a frame should be a 3x3 matrix"),
        ({"aligned_pose": [[1]]}, "aligned_pose of a frame should be a 4x4 matrix"),
        ({"intrinsic": np.diag([90.0, 90.0, 1.0]).tolist()}, "several cameras"),
    ],
)
def test_entries_that_cannot_be_used(scene, entry, message):
    _write(scene, {**scene[1], "frame_000010": {**scene[1]["frame_000010"], **entry}})
    with pytest.raises(InputError, match=message) as caught:
        open_recording(scene[0])
    assert len(str(caught.value).splitlines()) == 1


def test_what_is_missing_is_named(scene):
    folder, entries = scene
    for name in ("first", "frame_" + "9" * 5000):
        _write(scene, {name: {}})
        with pytest.raises(InputError, match="expected entries 'frame_000000'"):
            open_recording(folder)
    _write(scene, {})
    with pytest.raises(InputError, match="No frame of"):
        open_recording(folder)
    _write(scene, entries)
    (folder / "iphone/rgb").rename(folder / "iphone/colour")
    with pytest.raises(InputError, match=r"no rgb/frame_\*\.jpg and no rgb\.mkv"):
        open_recording(folder)
    (folder / "iphone/depth").rename(folder / "iphone/deep")
    with pytest.raises(InputError, match="export them with the toolkit"):
        open_recording(folder)
