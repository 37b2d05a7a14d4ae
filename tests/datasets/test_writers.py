"""The synthetic room written out and read back: the readers of three layouts."""

import json

import numpy as np
import pytest

from experiments.crash_faults import Faults
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import (
    KinectFaults,
    ReaderOptions,
    SyntheticRecording,
    open_recording,
    write_recording,
)

# Half a step of 16-bit depth, and what 8 bits or a JPEG take from colour.
LAYOUTS = {
    "tum": {"depth": 0.5 / 5000, "rgb": 0.5 / 255, "time": 5e-7},
    "replica": {"depth": 0.5 / 6553.5, "rgb": 0.1, "time": 0.0},
    "folder": {"depth": 0.5 / 1000, "rgb": 0.5 / 255, "time": 5e-7},
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_what_is_written_is_read(room, tmp_path, layout):
    write_recording(room, tmp_path / "room", layout=layout)
    recording = open_recording(tmp_path / "room")
    limits = LAYOUTS[layout]
    assert recording.dataset == layout
    assert recording.name == "room"
    assert recording.notes == ()
    assert len(recording) == len(room)
    assert recording.camera.shape == room.camera.shape
    np.testing.assert_allclose(recording.camera.matrix(), room.camera.matrix(), rtol=1e-7)
    np.testing.assert_allclose(recording.timestamps, room.timestamps, rtol=0, atol=limits["time"] + 1e-12)
    truth = recording.ground_truth
    assert truth is not None
    np.testing.assert_array_equal(truth.timestamps, recording.timestamps)
    np.testing.assert_allclose(truth.poses, room.ground_truth.poses, atol=1e-8)
    for i in range(len(room)):
        expected, got = room[i], recording[i]
        assert got.rgb.dtype == got.depth.dtype == np.float32
        assert got.timestamp == recording.timestamps[i]
        np.testing.assert_allclose(got.depth, expected.depth, rtol=1e-6, atol=limits["depth"] * 1.001)
        error = np.abs(got.rgb - expected.rgb)
        assert error.mean() < limits["rgb"] * 0.6
        assert error.max() < limits["rgb"] * (1.001 if layout != "replica" else 4)


def test_depth_time_stamps_survive_in_tum(tmp_path):
    late = SyntheticRecording(num_frames=2, width=80, height=60, faults=KinectFaults(depth_delay=0.012))
    write_recording(late, tmp_path / "tum", layout="tum")
    recording = open_recording(tmp_path / "tum")
    np.testing.assert_allclose(recording.timestamps, late.timestamps, atol=1e-6)
    for i in range(2):
        assert recording[i].depth_timestamp == pytest.approx(late.timestamps[i] + 0.012, abs=1e-6)


def test_frames_without_a_pose_stay_without(room, tmp_path):
    part = open_recording("synthetic:frames=5,width=80,height=60")

    class Untracked:
        name, dataset, camera, notes = "x", "synthetic", part.camera, ()
        timestamps = part.timestamps
        ground_truth = part.ground_truth[np.array([0, 2, 3])]

        def __len__(self):
            return len(part)

        def __getitem__(self, index):
            return part[index]

    write_recording(Untracked(), tmp_path / "folder", layout="folder")
    truth = open_recording(tmp_path / "folder").ground_truth
    np.testing.assert_allclose(truth.timestamps, room.timestamps[[0, 2, 3]], atol=1e-6)


def test_depth_beyond_the_range_becomes_missing(room, tmp_path):
    frame = room[0]

    class Far:
        name, dataset, camera, notes = "x", "synthetic", room.camera, ()
        timestamps, ground_truth = room.timestamps[:1], None

        def __len__(self):
            return 1

        def __getitem__(self, index):
            depth = np.asarray(frame.depth).copy()
            depth[0, :3] = [13.1, 13.2, 100.0]
            return type(frame)(frame.rgb, depth, 0.0)

    write_recording(Far(), tmp_path / "tum", layout="tum")
    recording = open_recording(tmp_path / "tum")
    assert recording.ground_truth is None
    np.testing.assert_allclose(np.asarray(recording[0].depth)[0, :3], [13.1, 0, 0], atol=1e-4)


def test_folder_that_is_not_empty_or_cannot_be_written_is_refused(room, tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="not empty"):
        write_recording(room, tmp_path / "full", layout="tum")
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["mine.txt"]
    with pytest.raises(InputError, match="Cannot write"):
        write_recording(room, tmp_path / "full" / "mine.txt" / "below", layout="tum")


def test_options_override_scale_and_camera(room, tmp_path):
    write_recording(room, tmp_path / "room", layout="tum")
    camera = {"fx": 70, "fy": 71, "cx": 40, "cy": 30}
    (tmp_path / "other.json").write_text(json.dumps(camera))
    options = ReaderOptions(depth_scale=2500.0, camera=tmp_path / "other.json")
    recording = open_recording(tmp_path / "room", options=options)
    assert float(recording.camera.fy) == 71
    np.testing.assert_allclose(recording[1].depth, 2 * np.asarray(room[1].depth), atol=3e-4)


def test_an_image_that_finds_no_room_is_not_left_in_part(room, tmp_path):
    with Faults("write", 3, for_ever=True), pytest.raises(InputError, match="room: No space left"):
        write_recording(room, tmp_path / "room", layout="folder")
    images = [path.name for kind in ("rgb", "depth") for path in (tmp_path / "room" / kind).iterdir()]
    # Both images of the first frame, and nothing of the second.
    assert len(images) == 2
