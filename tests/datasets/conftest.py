"""Small recordings to read back."""

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from sfgs_jax.datasets import SyntheticRecording


class CapturedFrame(NamedTuple):
    """A frame of the room as files hold it: (h, w, 3) RGB, (h/2, w/2) metres, and `T_world_cam`."""

    rgb: np.ndarray
    depth: np.ndarray
    pose: np.ndarray


@pytest.fixture(scope="session")
def room() -> SyntheticRecording:
    """A synthetic room of one small image size: each size compiles anew."""
    return SyntheticRecording(num_frames=5, width=80, height=60)


@pytest.fixture
def write_image():
    """Writes an RGB or depth array as an image file, with its folders."""

    def write(path, image: np.ndarray) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        assert cv2.imwrite(str(path), image)

    return write


@pytest.fixture
def write_video(tmp_path):
    """Writes RGB arrays as the frames of a video without loss, under any name."""

    def write(path, frames: list[np.ndarray]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        height, width = frames[0].shape[:2]
        made = tmp_path / "made.mkv"
        writer = cv2.VideoWriter(str(made), cv2.VideoWriter.fourcc(*"FFV1"), 30, (width, height))
        for frame in frames:
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()
        made.rename(path)

    return write


@pytest.fixture(scope="session")
def capture(room) -> list[CapturedFrame]:
    """The room as a phone stores it: colour of 8 bits, depth registered to it at half its size."""
    frames = [room[i] for i in range(len(room))]
    return [
        CapturedFrame(*_stored(frame), pose)
        for frame, pose in zip(frames, room.ground_truth.poses, strict=True)
    ]


def _stored(frame) -> tuple[np.ndarray, np.ndarray]:
    height, width = frame.depth.shape
    # Inverse depth is linear on a plane, so its mean over a block belongs to the block's centre.
    inverse = (1 / frame.depth).reshape(height // 2, 2, width // 2, 2).mean(axis=(1, 3))
    return np.round(frame.rgb * 255).astype(np.uint8), (1 / inverse).astype(np.float32)


@pytest.fixture
def check_capture(room, capture):
    """Compares a recording with the room: sizes, intrinsics, images and poses."""

    def check(
        recording, *, dataset: str, small_depth: bool = True, step: float = 0.001, notes: tuple = ()
    ) -> None:
        assert recording.dataset == dataset
        assert recording.notes == notes
        assert len(recording) == len(capture)
        assert recording.camera.shape == room.camera.shape
        np.testing.assert_allclose(recording.camera.matrix(), room.camera.matrix(), rtol=1e-6)
        np.testing.assert_array_equal(recording.ground_truth.timestamps, recording.timestamps)
        np.testing.assert_allclose(recording.ground_truth.poses, room.ground_truth.poses, atol=1e-6)
        for i, stored in enumerate(capture):
            frame = recording[i]
            assert frame.timestamp == recording.timestamps[i]
            assert np.abs(frame.rgb - stored.rgb / 255).max() < 0.01
            error = np.abs(frame.depth - room[i].depth)
            if small_depth:
                # Away from edges and creases depth is exact but for its steps.
                assert np.median(error) < step
                assert np.quantile(error / room[i].depth, 0.9) < 0.02
                surfaces = [stored.depth.repeat(2, 0).repeat(2, 1), room[i].depth]
                low, high = np.minimum(*surfaces), np.maximum(*surfaces)
                assert np.mean((frame.depth < 0.95 * low) | (frame.depth > 1.05 * high)) < 0.01
            else:
                assert error.max() < step

    return check


@pytest.fixture
def images(rng):
    """An RGB image and a depth image in 16-bit units from 1000 to 3000, of a given size."""

    def make(width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
        rgb = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
        return rgb, rng.integers(1000, 3000, (height, width), dtype=np.uint16)

    return make
