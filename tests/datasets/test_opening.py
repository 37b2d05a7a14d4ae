"""Recognising layouts, and what can't be opened."""

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import (
    LAYOUTS,
    ReaderOptions,
    Recording,
    SyntheticRecording,
    open_recording,
    write_recording,
)

SOURCE = "synthetic:frames=5,width=80,height=60"


def test_missing_path_file_and_unknown_layout(tmp_path):
    with pytest.raises(InputError, match=r"There is no .*nowhere"):
        open_recording(tmp_path / "nowhere")
    (tmp_path / "video.mp4").write_text("")
    with pytest.raises(InputError, match="is a file"):
        open_recording(tmp_path / "video.mp4")
    with pytest.raises(InputError, match=r"layout of .* is unknown") as caught:
        open_recording(tmp_path)
    for layout in LAYOUTS:
        assert layout == "synthetic" or f"({layout})" in str(caught.value)


def test_forced_layout(room, tmp_path):
    write_recording(room, tmp_path / "a", layout="tum")
    assert open_recording(tmp_path / "a").dataset == "tum"
    assert open_recording(tmp_path / "a", dataset="folder").dataset == "folder"
    with pytest.raises(InputError, match="no replica recording: it has no results/"):
        open_recording(tmp_path / "a", dataset="replica")
    with pytest.raises(InputError, match="no layout 'kitti'; choose from tum"):
        open_recording(tmp_path / "a", dataset="kitti")


def test_folder_of_recordings_names_them(room, tmp_path):
    write_recording(room, tmp_path / "first", layout="tum")
    with pytest.raises(InputError, match="recordings inside it: first"):
        open_recording(tmp_path)


def test_synthetic_source():
    recording = open_recording(SOURCE + ",seed=3,noise=1")
    assert isinstance(recording, Recording)
    assert (recording.dataset, len(recording), recording.camera.shape) == ("synthetic", 5, (60, 80))
    assert len(open_recording("synthetic")) == 120
    with pytest.raises(InputError, match="is no synthetic recording"):
        open_recording("/dev/zero", dataset="synthetic")
    for source in ("synthetic:frame=5", "synthetic:frames", "synthetic:frames=a", "synthetic:frames=0"):
        with pytest.raises(InputError, match="synthetic"):
            open_recording(source)


def test_selection_of_frames(room):
    recording = open_recording(SOURCE, options=ReaderOptions(start=1, end=5, stride=2))
    assert len(recording) == 2
    np.testing.assert_allclose(recording.timestamps, room.timestamps[[1, 3]])
    np.testing.assert_allclose(recording.ground_truth.poses, room.ground_truth.poses[[1, 3]])
    frame = recording[1]
    assert frame.timestamp == room.timestamps[3]
    np.testing.assert_allclose(frame.depth, room[3].depth)
    with pytest.raises(IndexError):
        recording[2]


def test_depth_limit(room):
    limit = float(np.median(room[0].depth))
    depth = np.asarray(open_recording(SOURCE, options=ReaderOptions(max_depth=limit))[0].depth)
    whole = np.asarray(room[0].depth)
    np.testing.assert_array_equal(depth, np.where(whole <= limit, whole, 0))


def test_a_frame_without_depth_is_a_frame(room, tmp_path, write_image):
    assert not np.any(open_recording(SOURCE, options=ReaderOptions(max_depth=0.1))[0].depth)
    write_recording(room, tmp_path / "a", layout="folder")
    path = sorted((tmp_path / "a" / "depth").iterdir())[2]
    write_image(path, np.zeros((60, 80), np.uint16))
    recording = open_recording(tmp_path / "a")
    assert np.any(recording[1].depth)
    assert not np.any(recording[2].depth)
    np.testing.assert_allclose(recording[2].rgb, room[2].rgb, atol=0.003)


@pytest.mark.parametrize(
    ("options", "message"),
    [(ReaderOptions(start=5), "it has 5"), (ReaderOptions(start=3, end=2), "from 3 to 2")],
)
def test_selection_that_leaves_nothing(options, message):
    with pytest.raises(InputError, match=message):
        open_recording(SOURCE, options=options)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"stride": 0}, "stride"),
        ({"max_depth": 0.0}, "max_depth"),
        ({"max_depth": float("nan")}, "max_depth"),
        ({"depth_scale": -1.0}, "depth_scale"),
        ({"depth_scale": float("inf")}, "depth_scale"),
        ({"association_limit": -0.1}, "association_limit"),
        ({"association_limit": float("nan")}, "association_limit"),
    ],
)
def test_settings_that_make_no_sense_are_refused(setting, message):
    with pytest.raises(InputError, match=message) as caught:
        ReaderOptions(**setting)
    assert str(caught.value).count(". ") == 0


@pytest.mark.parametrize("layout", ["tum", "folder", "replica"])
def test_a_given_camera_file_that_is_not_there(room, tmp_path, layout):
    write_recording(room, tmp_path / "a", layout=layout)
    with pytest.raises(InputError, match=r"given camera file .*none\.json does not exist"):
        open_recording(tmp_path / "a", options=ReaderOptions(camera=tmp_path / "none.json"))


def test_rooms_of_impossible_size():
    with pytest.raises(InputError, match="at least 1 frame"):
        SyntheticRecording(num_frames=0)
    with pytest.raises(InputError, match="16x16"):
        SyntheticRecording(width=8)
    for source in (
        "synthetic:width=100000,height=100000",
        "synthetic:frames=9999999999",
        "synthetic:seed=9999999999",
    ):
        with pytest.raises(InputError, match="of a synthetic recording is at most"):
            open_recording(source)
    with pytest.raises(InputError, match="is not understood at") as caught:
        open_recording(f"synthetic:frames={'9' * 5000}")
    assert len(str(caught.value)) < 400
