"""Live frames of an Intel RealSense camera, with depth aligned to colour."""

from collections.abc import Iterator
from types import TracebackType
from typing import Any

import numpy as np

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Camera, Frame

_LARGEST_DISTORTION = 0.01
"""Lens coefficients up to here move no pixel of a RealSense's colour image by more than about one."""


class RealSense:
    """A stream of frames from a RealSense camera, through `pip install pyrealsense2`.

    Iterate over it for numbers and frames, as `slam.run` takes them, until it is closed. It is a context
    manager. Frames are in the colour camera, which is taken for a pinhole.

    Args:
        width: of both images, pixels.
        height: of both images, pixels.
        rate: frames per second.

    Attributes:
        camera: intrinsics of the frames.
        notes: warnings for the log, one sentence each.

    Raises:
        InputError: pyrealsense2 is not installed, or no camera gives such images.
    """

    def __init__(self, *, width: int = 640, height: int = 480, rate: int = 30) -> None:
        try:
            import pyrealsense2 as rs  # pyright: ignore[reportMissingImports]
        except ImportError as error:
            raise InputError("Live frames need pyrealsense2: pip install pyrealsense2.") from error
        self._pipeline: Any = rs.pipeline()
        config = rs.config()
        config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
        config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
        try:
            profile = self._pipeline.start(config)
        except RuntimeError as error:
            raise InputError(
                f"No RealSense camera gives {width}x{height} colour and depth at {rate} Hz: {error}."
            ) from error
        self._align: Any = rs.align(rs.stream.color)
        self._metres = profile.get_device().first_depth_sensor().get_depth_scale()
        given = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        self.camera = Camera(given.fx, given.fy, given.ppx, given.ppy, width=given.width, height=given.height)
        bent = np.max(np.abs(given.coeffs), initial=0) > _LARGEST_DISTORTION
        self.notes = ("The colour camera's lens distortion is not corrected.",) if bent else ()

    def __iter__(self) -> Iterator[tuple[int, Frame]]:
        """Numbers and frames, as they come; frames without one of the two images are left out.

        The device numbers colour images, so numbers that are missing are frames that were dropped.
        """
        first = None
        while self._pipeline is not None:
            images = self._align.process(self._pipeline.wait_for_frames())
            colour, depth = images.get_color_frame(), images.get_depth_frame()
            if not colour or not depth:
                continue
            number = int(colour.get_frame_number())
            first = number if first is None else first
            # The arrays belong to the driver, which reuses them.
            rgb = np.asarray(colour.get_data(), np.float32) / np.float32(255)
            metres = np.asarray(depth.get_data(), np.float32) * np.float32(self._metres)
            times = colour.get_timestamp() / 1000, depth.get_timestamp() / 1000
            yield number - first, Frame(rgb, metres, *times)

    def close(self) -> None:
        """Stop the camera; a second call does nothing."""
        if self._pipeline is not None:
            self._pipeline.stop()
            self._pipeline = None

    def __enter__(self) -> "RealSense":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        self.close()
