"""A RealSense camera, played by a module that stands in for pyrealsense2."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import RealSense

WIDTH, HEIGHT = 8, 6


class Image:
    def __init__(self, data, number):
        self.data, self.number = data, number

    def get_data(self):
        return self.data

    def get_frame_number(self):
        return self.number

    def get_timestamp(self):
        return 1000 * (1_700_000_000 + self.number / 30)


class Pipeline:
    """Three pairs of images, of which the second lacks depth; then it waits no longer."""

    coefficients = (0.0,) * 5
    stopped = 0

    def __init__(self):
        self.numbers = iter((40, 41, 43))

    def start(self, config):
        if config.streams != {("colour", WIDTH, HEIGHT, "rgb8", 15), ("depth", WIDTH, HEIGHT, "z16", 15)}:
            raise RuntimeError("Couldn't resolve requests")
        intrinsics = SimpleNamespace(
            fx=7.0, fy=7.5, ppx=3.5, ppy=2.5, width=WIDTH, height=HEIGHT, coeffs=self.coefficients
        )
        video = SimpleNamespace(get_intrinsics=lambda: intrinsics)
        sensor = SimpleNamespace(get_depth_scale=lambda: 0.00025)
        return SimpleNamespace(
            get_stream=lambda stream: SimpleNamespace(as_video_stream_profile=lambda: video),
            get_device=lambda: SimpleNamespace(first_depth_sensor=lambda: sensor),
        )

    def wait_for_frames(self):
        number = next(self.numbers)
        colour = Image(np.full((HEIGHT, WIDTH, 3), 51, np.uint8), number)
        depth = Image(np.full((HEIGHT, WIDTH), 4000 + number, np.uint16), number)
        return colour, None if number == 41 else depth

    def stop(self):
        type(self).stopped += 1


class Config:
    def __init__(self):
        self.streams = set()

    def enable_stream(self, *stream):
        self.streams.add(stream)


class Align:
    def __init__(self, stream):
        assert stream == "colour"

    def process(self, images):
        colour, depth = images
        return SimpleNamespace(get_color_frame=lambda: colour, get_depth_frame=lambda: depth)


@pytest.fixture
def camera(monkeypatch) -> type[Pipeline]:
    stand_in = SimpleNamespace(
        pipeline=Pipeline,
        config=Config,
        align=Align,
        stream=SimpleNamespace(color="colour", depth="depth"),
        format=SimpleNamespace(rgb8="rgb8", z16="z16"),
    )
    monkeypatch.setitem(sys.modules, "pyrealsense2", stand_in)
    monkeypatch.setattr(Pipeline, "stopped", 0)
    return Pipeline


def opened() -> RealSense:
    return RealSense(width=WIDTH, height=HEIGHT, rate=15)


def test_frames_come_with_their_numbers_times_and_units(camera):
    with opened() as device:
        assert (float(device.camera.fx), float(device.camera.cy), device.camera.shape) == (7.0, 2.5, (6, 8))
        assert device.notes == ()
        frames = iter(device)
        (first, frame), (third, later) = next(frames), next(frames)
    assert (first, third) == (0, 3)
    np.testing.assert_allclose(frame.rgb, 0.2)
    np.testing.assert_allclose(frame.depth, 4040 * 0.00025, rtol=1e-6)
    assert (frame.rgb.dtype, frame.depth.dtype) == (np.float32, np.float32)
    np.testing.assert_allclose(later.timestamp - frame.timestamp, 0.1, atol=1e-6)
    assert later.depth_timestamp == later.timestamp


def test_a_closed_camera_ends_its_frames(camera):
    device = opened()
    frames = iter(device)
    next(frames)
    device.close()
    device.close()
    assert camera.stopped == 1
    assert list(frames) == []


def test_a_bent_lens_is_noted(camera, monkeypatch):
    monkeypatch.setattr(camera, "coefficients", (0.1, 0.0, 0.0, 0.0, 0.0))
    assert opened().notes == ("The colour camera's lens distortion is not corrected.",)


def test_without_camera_or_package_one_sentence_says_so(camera, monkeypatch):
    with pytest.raises(InputError, match="No RealSense camera gives 640x480 colour and depth at 30 Hz"):
        RealSense()
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(InputError, match="pip install pyrealsense2"):
        RealSense()
