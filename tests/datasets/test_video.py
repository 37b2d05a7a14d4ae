"""A video with a folder of depth images."""

import json

import cv2
import numpy as np
import pytest

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import open_recording


@pytest.fixture
def desk(tmp_path, room, capture, write_image, write_video):
    folder = tmp_path / "desk"
    write_video(folder / "clip.mkv", [frame.rgb for frame in capture])
    for n, frame in enumerate(capture):
        write_image(folder / f"depth/{n}.png", np.round(frame.depth * 1000).astype(np.uint16))
    camera = room.camera
    content = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    (folder / "camera.json").write_text(json.dumps(content))
    np.savetxt(folder / "poses.txt", np.stack([frame.pose for frame in capture]).reshape(-1, 16))
    return folder


def _rename(folder, name) -> None:
    for n in reversed(range(5)):
        (folder / f"depth/{n}.png").rename(folder / f"depth/{name(n)}.png")


def test_images_poses_and_intrinsics(desk, check_capture):
    recording = open_recording(desk)
    check_capture(recording, dataset="video")
    np.testing.assert_allclose(recording.timestamps, np.arange(5) / 30)


@pytest.mark.parametrize("name", [lambda n: n + 1, lambda n: f"{n:04d}", lambda n: f"depth_{n}"])
def test_names_of_depth_images(desk, check_capture, name):
    _rename(desk, name)
    check_capture(open_recording(desk), dataset="video")


def test_depth_of_some_frames(desk, capture):
    (desk / "poses.txt").unlink()
    for n in (0, 2):
        (desk / f"depth/{n}.png").unlink()
    (desk / "depth/1.png").rename(desk / "depth/90.png")
    recording = open_recording(desk)
    np.testing.assert_allclose(recording.timestamps, [3 / 30, 4 / 30])
    assert recording.notes == ("1 of 3 depth images lie beyond the end of the video.",)
    assert np.abs(recording[0].rgb - capture[3].rgb / 255).max() < 0.01


def test_frame_rate_of_the_camera_file(desk):
    content = json.loads((desk / "camera.json").read_text())
    (desk / "camera.json").write_text(json.dumps({**content, "fps": 10}))
    np.testing.assert_allclose(open_recording(desk).timestamps, np.arange(5) / 10)


def test_a_video_that_ends_early(desk):
    data = (desk / "clip.mkv").read_bytes()
    (desk / "clip.mkv").write_bytes(data[: len(data) // 2])
    recording = open_recording(desk)
    recording[0]
    with pytest.raises(FrameError, match=r"Frame 4 of .*clip\.mkv cannot be decoded"):
        recording[4]


def test_a_stream_that_does_not_tell_its_length(desk, capture):
    images = [
        cv2.imencode(".jpg", frame.rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1] for frame in capture
    ]
    (desk / "clip.mkv").unlink()
    (desk / "clip.avi").write_bytes(b"".join(image.tobytes() for image in images))
    recording = open_recording(desk)
    assert len(recording) == 5
    assert np.abs(recording[3].rgb - capture[3].rgb / 255).mean() < 0.02


def test_what_cannot_be_used(desk):
    (desk / "other.mp4").write_text("")
    with pytest.raises(InputError, match=r"should have one video, but has clip\.mkv, other\.mp4"):
        open_recording(desk)
    (desk / "other.mp4").unlink()
    (desk / "depth/3.png").rename(desk / "depth/last.png")
    (desk / "depth/4.png").unlink()
    with pytest.raises(InputError, match="5 video frames and 4 depth images"):
        open_recording(desk)
    (desk / "camera.json").unlink()
    with pytest.raises(InputError, match=r"Intrinsics of .* are missing: write .*camera\.json"):
        open_recording(desk)
