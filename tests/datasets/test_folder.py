"""Plain folders: what users record themselves."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import Trajectory, format_tum, se3

CAMERA = {"fx": 20.0, "fy": 21.0, "cx": 15.5, "cy": 11.5}


@pytest.fixture
def record(tmp_path, write_image, images):
    """Writes a folder with images of given names and a camera file."""

    def write(colour: list[str], depth: list[str], camera: dict | None = CAMERA, size: tuple = (32, 24)):
        folder = tmp_path / "mine"
        for kind, names in (("rgb", colour), ("depth", depth)):
            (folder / kind).mkdir(parents=True, exist_ok=True)
            for i, name in enumerate(names):
                rgb, units = images(*size)
                units[0, 0] = 1000 + i
                path = folder / kind / name
                if name.endswith(".npy"):
                    np.save(path, units / 1000)
                else:
                    write_image(path, rgb if kind == "rgb" else units)
        if camera is not None:
            (folder / "camera.json").write_text(json.dumps(camera))
        return folder

    return write


def _first_depths(recording) -> list[float]:
    return [round(float(np.asarray(recording[i].depth)[0, 0]), 3) for i in range(len(recording))]


def test_equal_numbers_are_matched_in_natural_order(record):
    folder = record([f"c{n}.jpg" for n in range(11)], [f"d{n:02d}.png" for n in range(11)])
    recording = open_recording(folder)
    assert recording.dataset == "folder"
    assert _first_depths(recording) == [round(1 + n / 1000, 3) for n in range(11)]
    np.testing.assert_allclose(recording.timestamps, np.arange(11) / 30)
    assert recording.ground_truth is None


def test_other_numbers_are_matched_by_name(record):
    recording = open_recording(record(["a.png", "b.png", "c.png"], ["c.npy", "a.npy"]))
    assert len(recording) == 2
    assert _first_depths(recording) == [1.001, 1.0]
    assert "1 of 3 colour images" in recording.notes[0]


def test_names_in_another_order_are_matched_by_name(record):
    recording = open_recording(record(["2.png", "10.png"], ["10.png", "2.png"]))
    assert _first_depths(recording) == [1.001, 1.0]


def test_numbers_with_a_decimal_point_are_time_stamps(record):
    names = ["1700000000.25.png", "1700000000.50.png"]
    recording = open_recording(record(names, names))
    assert recording.timestamps.tolist() == [1700000000.25, 1700000000.5]
    # A name that depth shares with colour pairs the two, and is not depth's time.
    assert recording[1].depth_timestamp is None


def test_depth_images_named_by_another_time_have_their_own(record):
    recording = open_recording(record(["17.25.png", "17.50.png"], ["17.26.png", "17.51.png"]))
    assert [recording[i].timestamp for i in range(2)] == [17.25, 17.5]
    assert [recording[i].depth_timestamp for i in range(2)] == [17.26, 17.51]


def test_frame_rate_and_depth_scale(record):
    folder = record(["0.png", "1.png"], ["0.png", "1.png"], {**CAMERA, "fps": 10, "depth_scale": 500})
    recording = open_recording(folder)
    np.testing.assert_allclose(recording.timestamps, [0, 0.1])
    assert _first_depths(recording) == [2.0, 2.002]


def _poses() -> Trajectory:
    poses = [
        np.asarray(se3.matrix(se3.exp(jnp.asarray([0.1, n, 0, 0.3, 0, n / 9]))), float) for n in (0.0, 1.0)
    ]
    return Trajectory(np.arange(2) / 30, np.stack(poses))


@pytest.mark.parametrize("layout", ["tum", "matrix"])
def test_poses(record, layout):
    names = ["0.png", "1.png"]
    folder = record(names, names)
    truth = _poses()
    if layout == "tum":
        (folder / "poses.txt").write_text(format_tum(truth))
    else:
        np.savetxt(folder / "poses.txt", truth.poses.reshape(2, 16))
    got = open_recording(folder).ground_truth
    np.testing.assert_allclose(got.poses, truth.poses, atol=1e-6)
    np.testing.assert_allclose(got.timestamps, truth.timestamps)


def test_number_of_poses_must_be_that_of_frames(record):
    folder = record(["0.png"], ["0.png"])
    np.savetxt(folder / "poses.txt", _poses().poses.reshape(2, 16))
    with pytest.raises(InputError, match="2 poses for 1 frames"):
        open_recording(folder)


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (None, r"Intrinsics of .*mine are missing: write .*camera\.json, for example"),
        ({"fx": 20, "fy": 20}, "lacks cx, cy"),
        ({**CAMERA, "cx": None}, "lacks cx"),
        ({**CAMERA, "fx": "20"}, "fx must be a positive number"),
        ({**CAMERA, "depth_scale": 0}, "depth_scale must be a positive number"),
        ({**CAMERA, "width": 640, "height": 480}, "are for 640x480 images, but the images are 32x24"),
        ({**CAMERA, "width": 640}, r"are for 640x\? images"),
        ({**CAMERA, "cx": 320.0}, "lies outside"),
        ([1, 2], "one JSON object"),
    ],
)
def test_camera_file_that_cannot_be_used(record, camera, message):
    with pytest.raises(InputError, match=message):
        open_recording(record(["0.png"], ["0.png"], camera))


def test_camera_file_that_is_no_json(record):
    folder = record(["0.png"], ["0.png"])
    for text in ("{fx: 1}", '{"fx": ' + "9" * 5000 + "}", "[" * 100_000):
        (folder / "camera.json").write_text(text)
        with pytest.raises(InputError, match="not valid JSON"):
            open_recording(folder)


def test_entries_that_are_not_used_are_noted(record):
    folder = record(["0.png"], ["0.png"], {**CAMERA, "k1": 0.1})
    expected = f"{folder / 'camera.json'} has entries that are not used: k1."
    assert open_recording(folder).notes == (expected,)


def test_implausible_scale_is_noted(record):
    recording = open_recording(record(["0.png"], ["0.png"], {**CAMERA, "depth_scale": 1}))
    assert "check the depth scale" in recording.notes[0]


def test_no_images(record):
    with pytest.raises(InputError, match=r"No images in .*rgb"):
        open_recording(record([], ["0.png"]))


def test_names_that_do_not_match(record):
    with pytest.raises(InputError, match="no two share a name"):
        open_recording(record(["a.png", "b.png"], ["c.png"]))


def test_colour_and_depth_of_different_sizes(record, write_image, images):
    folder = record(["0.png"], ["0.png"])
    write_image(folder / "depth" / "0.png", images(16, 12)[1])
    with pytest.raises(InputError, match="32x24 but depth images are 16x12"):
        open_recording(folder)


def test_first_frames_may_be_damaged_but_not_all(record):
    folder = record(["0.png", "1.png"], ["0.png", "1.png"])
    (folder / "rgb" / "0.png").write_bytes(b"")
    recording = open_recording(folder)
    with pytest.raises(FrameError, match="truncated"):
        recording[0]
    recording[1]
    (folder / "depth" / "1.png").write_bytes(b"")
    with pytest.raises(InputError, match="None of the first frames"):
        open_recording(folder)


def test_frame_of_another_size(record, write_image, images):
    folder = record(["0.png", "1.png", "2.png"], ["0.png", "1.png", "2.png"])
    write_image(folder / "depth" / "1.png", images(16, 12)[1])
    for kind, image in zip(("rgb", "depth"), images(16, 12), strict=True):
        write_image(folder / kind / "2.png", image)
    recording = open_recording(folder)
    with pytest.raises(FrameError, match="16x12"):
        recording[1]
    with pytest.raises(FrameError, match="16x12"):
        recording[2]
