"""Captures of Stray Scanner: a video, small depth with confidence, ARKit's poses."""

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.geometry import quaternions_from_rotations


@pytest.fixture
def scan(tmp_path, room, capture, write_image, write_video):
    folder = tmp_path / "3f2a1c"
    write_video(folder / "rgb.mp4", [frame.rgb for frame in capture])
    header = "timestamp, frame, x, y, z, qx, qy, qz, qw, fx, fy, cx, cy"
    lines = [header]
    for n, frame in enumerate(capture):
        write_image(folder / f"depth/{n:06d}.png", np.round(frame.depth * 1000).astype(np.uint16))
        write_image(folder / f"confidence/{n:06d}.png", np.full(frame.depth.shape, 2, np.uint8))
        w, x, y, z = quaternions_from_rotations(frame.pose[None, :3, :3])[0]
        numbers = (7000 + n / 60, *frame.pose[:3, 3], x, y, z, w)
        cells = [f"{value:.9f}" for value in numbers]
        lines.append(", ".join([cells[0], f"{n:06d}", *cells[1:], "", "", "", ""]))
    (folder / "odometry.csv").write_text("\n".join(lines) + "\n")
    rows = [", ".join(map(str, row)) for row in np.asarray(room.camera.matrix(), float).tolist()]
    (folder / "camera_matrix.csv").write_text("\n".join(rows))
    return folder


def test_images_poses_and_intrinsics(scan, check_capture):
    recording = open_recording(scan)
    check_capture(recording, dataset="stray")
    np.testing.assert_allclose(recording.timestamps, 7000 + np.arange(5) / 60)


def test_frames_come_in_any_order(scan, capture):
    recording = open_recording(scan)
    for i in (3, 1, 4, 0):
        assert np.abs(recording[i].rgb - capture[i].rgb / 255).max() < 0.01


def test_depth_of_low_confidence_is_missing(scan, capture, write_image):
    levels = np.zeros(capture[1].depth.shape, np.uint8)
    levels[:, 10:], levels[:, 20:] = 1, 2
    write_image(scan / "confidence" / "000001.png", levels)
    for least, first in ((0, 0), (1, 20), (2, 40)):
        depth = open_recording(scan, options=ReaderOptions(min_confidence=least))[1].depth
        np.testing.assert_array_equal((depth > 0).all(axis=0), np.arange(80) >= first)
    write_image(scan / "confidence" / "000001.png", levels[:, 1:])
    with pytest.raises(FrameError, match=r"000001\.png is 39x30, but its depth image is 40x30"):
        open_recording(scan)[1]


def test_frames_without_images_are_left_out(scan):
    (scan / "depth" / "000002.png").unlink()
    with (scan / "odometry.csv").open("a") as file:
        file.write("7001, 90, 0, 0, 0, 0, 0, 0, 1\n")
    recording = open_recording(scan)
    assert len(recording) == 4
    assert recording.notes == ("2 of 6 frames have no colour or no depth image and are left out.",)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("camera_matrix.csv", "1, 2\n", "camera_matrix.csv should hold a 3x3"),
        ("camera_matrix.csv", "a, 2, 3\n", "line 1: expected numbers"),
        ("odometry.csv", "timestamp, frame, x\n", "lacks the column 'y'"),
        ("odometry.csv", "", "lacks the column 'timestamp'"),
        ("odometry.csv", "timestamp, frame, x, y, z, qx, qy, qz, qw\n1, 0, 2\n", "line 2: expected numbers"),
        ("odometry.csv", "timestamp, frame, x, y, z, qx, qy, qz, qw\n", "No pairs of colour and depth"),
        ("rgb.mp4", "no video", r"rgb\.mp4 cannot be decoded as a video"),
    ],
)
def test_files_that_cannot_be_used(scan, name, text, message):
    (scan / name).write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        open_recording(scan)
    assert len(str(caught.value).splitlines()) == 1


def test_damaged_poses_and_times(scan):
    path = scan / "odometry.csv"
    lines = path.read_text().splitlines()
    cells = [line.split(", ") for line in lines]
    for row, column, value in ((1, 2, "1e308"), (2, 5, "1e308"), (3, 8, "nan")):
        cells[row][column] = value
    path.write_text("\n".join(", ".join(row) for row in cells))
    recording = open_recording(scan)
    assert recording.notes == ("3 ground-truth poses are not finite and ignored.",)
    path.write_text("\n".join([lines[0], lines[2], lines[1]]))
    with pytest.raises(InputError, match=r"time stamps in .*odometry\.csv do not increase"):
        open_recording(scan)


def test_a_capture_without_its_video(scan):
    (scan / "rgb.mp4").unlink()
    with pytest.raises(InputError, match=r"There is no video .*rgb\.mp4"):
        open_recording(scan)
