"""Videos: their frames as colour images."""

import threading
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets.files._images import MOST_PIXELS, colour_of_bgr

VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v")
"""Endings of videos."""


class Video:
    """A video file, decoded in order.

    A phone's video has no constant rate, so seeking by number can miss by a frame. Instead every frame up to
    the wanted one is decoded, from the last one asked for, or from the beginning if that is before it.

    Attributes:
        path: the file.
        frames_per_second: nominal rate.
        num_frames: number of frames, by the file's header if it has one; some of the last may be missing.
    """

    def __init__(self, path: Path) -> None:
        """Open a video.

        Raises:
            InputError: there is no file, it can't be decoded, or it has an impossible size.
        """
        if not path.is_file():
            raise InputError(f"There is no video {path}.")
        self.path = path
        self._lock = threading.Lock()
        self._capture = self._opened()
        self._next = 0
        self.frames_per_second = float(self._capture.get(cv2.CAP_PROP_FPS)) or 30.0
        sides = [self._capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
        if min(sides) < 1 or sides[0] * sides[1] > MOST_PIXELS:
            raise InputError(f"{path} says that its frames are {sides[0]:g}x{sides[1]:g}, which can't be.")
        self.num_frames = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))
        if self.num_frames <= 0:
            while self._capture.grab():
                self._next += 1
            self.num_frames = self._next

    def rgb(self, index: int) -> Float[np.ndarray, "h w 3"]:
        """RGB in [0, 1] of a frame.

        Args:
            index: number of the frame, from 0.

        Raises:
            FrameError: the video ends before it, or it can't be decoded.
        """
        with self._lock:
            if index < self._next:
                self._capture.release()
                self._capture, self._next = self._opened(), 0
            while self._next < index and self._capture.grab():
                self._next += 1
            found, image = self._capture.read() if self._next == index else (False, None)
            self._next += found
        if not found or image is None:
            raise FrameError(f"Frame {index} of {self.path} cannot be decoded.")
        return colour_of_bgr(image)

    def _opened(self) -> cv2.VideoCapture:
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise InputError(f"{self.path} cannot be decoded as a video.")
        # Depth has no orientation tag, so that of the video is ignored.
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        return capture


@dataclass(frozen=True)
class VideoFrame:
    """A frame of a video as a `ColourImage`.

    Attributes:
        video: the video.
        index: number of the frame, from 0.
    """

    video: Video
    index: int

    def rgb(self) -> Float[np.ndarray, "h w 3"]:
        """RGB in [0, 1]. Raises FrameError as `Video.rgb`."""
        return self.video.rgb(self.index)

    def __str__(self) -> str:
        return f"frame {self.index} of {self.video.path}"
