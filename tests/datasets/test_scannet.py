"""ScanNet frames: colour brought to the depth camera."""

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording

COLOUR = (120.0, 121.0, 63.0, 47.0)
DEPTH = (58.0, 57.0, 32.5, 26.0)


def _matrix(fx: float, fy: float, cx: float, cy: float) -> np.ndarray:
    matrix = np.eye(4)
    matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2] = fx, fy, cx, cy
    return matrix


def _pattern(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth colour in [0, 1] for each ray (x, y, 1)."""
    return 0.5 + 0.4 * np.stack([np.sin(3 * x), np.sin(4 * y), np.cos(3 * x + 2 * y)], axis=-1)


def _rays(width: int, height: int, fx: float, fy: float, cx: float, cy: float):
    v, u = np.mgrid[:height, :width]
    return (u - cx) / fx, (v - cy) / fy


@pytest.fixture
def scan(tmp_path, write_image):
    """Frames 0 and 20 of a pattern at infinity, at 128x96 in colour and 64x48 in depth."""
    folder = tmp_path / "scene0000_00"
    (folder / "pose").mkdir(parents=True)
    (folder / "intrinsic").mkdir()
    for n in (0, 20):
        rgb = np.round(_pattern(*_rays(128, 96, *COLOUR)) * 255).astype(np.uint8)
        write_image(folder / "color" / f"{n}.png", rgb)
        write_image(folder / "depth" / f"{n}.png", np.full((48, 64), 1500, np.uint16))
        np.savetxt(folder / "pose" / f"{n}.txt", np.eye(4) if n == 0 else np.full((4, 4), -np.inf))
    np.savetxt(folder / "intrinsic" / "intrinsic_color.txt", _matrix(*COLOUR))
    np.savetxt(folder / "intrinsic" / "intrinsic_depth.txt", _matrix(*DEPTH))
    return folder


def test_colour_is_what_the_depth_camera_would_see(scan):
    recording = open_recording(scan)
    assert recording.dataset == "scannet"
    camera = recording.camera
    assert camera.shape == (48, 64)
    np.testing.assert_allclose([float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)], DEPTH)
    frame = recording[0]
    np.testing.assert_allclose(frame.depth, 1.5)
    expected = _pattern(*_rays(64, 48, *DEPTH))
    error = np.abs(np.asarray(frame.rgb) - expected)[4:-4, 4:-4]
    assert error.max() < 0.01
    # Scaling alone would be off by a pixel or two.
    scaled = _pattern(*_rays(64, 48, 60, 60.5, 31.25, 23.25))
    assert np.abs(scaled - expected)[4:-4, 4:-4].max() > 0.03


def test_without_depth_intrinsics_those_of_colour_are_scaled(scan):
    (scan / "intrinsic" / "intrinsic_depth.txt").unlink()
    recording = open_recording(scan)
    camera = recording.camera
    np.testing.assert_allclose(
        [float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy)], [60, 60.5, 31.25, 23.25]
    )
    expected = _pattern(*_rays(64, 48, 60, 60.5, 31.25, 23.25))
    assert np.abs(np.asarray(recording[0].rgb) - expected).max() < 0.01


def test_infinite_poses_are_left_out(scan):
    recording = open_recording(scan)
    assert len(recording) == 2
    np.testing.assert_allclose(recording.timestamps, [0, 20 / 30])
    assert recording.ground_truth.timestamps.tolist() == [0.0]
    assert recording.notes == ("1 ground-truth pose is not finite and ignored.",)


def test_missing_or_broken_intrinsics_are_refused(scan):
    (scan / "intrinsic" / "intrinsic_color.txt").write_text("1 2 3\n")
    with pytest.raises(InputError, match="3x3 or 4x4"):
        open_recording(scan)
    (scan / "intrinsic" / "intrinsic_color.txt").unlink()
    with pytest.raises(InputError, match=r"Intrinsics of .* are missing"):
        open_recording(scan)


def test_colour_of_another_size_is_a_frame_error(scan, write_image):
    write_image(scan / "color" / "20.png", np.zeros((50, 50, 3), np.uint8))
    with pytest.raises(FrameError, match="50x50"):
        open_recording(scan)[1]
