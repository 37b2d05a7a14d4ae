"""Images, videos and maps that a viewer writes to files."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, write_atomically
from sfgs_jax.geometry import Camera, Trajectory
from sfgs_jax.splatting import save_gltf, save_ply, save_splat, save_spz
from sfgs_jax.viewer._modes import Look
from sfgs_jax.viewer._painting import Painter
from sfgs_jax.viewer._video import path_in_time, write_video

MapFormat = Literal["ply", "spz", "glb", "splat"]
"""Formats of maps, by the suffixes of their files."""

MAP_FORMATS: tuple[MapFormat, ...] = get_args(MapFormat)

_WRITERS = {"ply": save_ply, "spz": save_spz, "glb": save_gltf, "splat": save_splat}

SMALLEST_SIDE, LARGEST_SIDE = 16, 4096
"""Limits of the sides of images and videos, pixels."""


class MapFiles:
    """Writes what a viewer shows.

    Args:
        painter: renders the map.
        trajectory: the path of videos; may be empty.
    """

    def __init__(self, painter: Painter, trajectory: Trajectory) -> None:
        self._painter, self._trajectory = painter, trajectory

    def still(
        self, path: Path, T_world_cam: Float[np.ndarray, "4 4"], camera: Camera, look: Look, *, dark: bool
    ) -> None:
        """Write an image of the map as PNG.

        Args:
            path: the file; one that exists is replaced.
            T_world_cam: pose of the camera.
            camera: intrinsics and size of the image.
            look: what to draw.
            dark: whether black is behind the map, or white.

        Raises:
            InputError: the size is out of range.
        """
        _check_size(camera)
        image = self._painter.paint(T_world_cam, camera, look, background=_background(dark))
        data = cv2.imencode(".png", image[..., ::-1])[1]
        write_atomically(path, data.tobytes())

    def video(
        self,
        path: Path,
        camera: Camera,
        look: Look,
        *,
        dark: bool,
        speed: float,
        progress: Callable[[float], bool],
    ) -> bool:
        """Write a video of the map along the path as MP4.

        Args:
            path: the file; one that exists is replaced.
            camera: of the video, with even width and height.
            look: what to draw.
            dark: whether black is behind the map, or white.
            speed: seconds of the recording per second.
            progress: told the share that is done; it answers whether to go on.

        Returns:
            Whether it went to the end.

        Raises:
            InputError: there is no path, the size is out of range, or the file can't be written.
        """
        _check_size(camera)
        if not len(self._trajectory):
            raise InputError("Without a path there is no video.")
        poses, background = path_in_time(self._trajectory, speed), _background(dark)
        return write_video(
            path,
            poses,
            lambda pose: self._painter.paint(pose, camera, look, background=background),
            progress=lambda done: progress(done / len(poses)),
        )

    def map(self, path: Path, look: Look) -> None:
        """Write the Gaussians that are shown; the suffix names the format."""
        write = _WRITERS.get(path.suffix.lower().removeprefix("."))
        if write is None:
            suffixes = ", ".join(f".{name}" for name in MAP_FORMATS)
            raise InputError(f"The suffix of {path} names no format: use {suffixes}.")
        gaussians = self._painter.shown(look)
        if not np.asarray(gaussians.valid).any():
            raise InputError("No Gaussian is shown: there is nothing to save.")
        write(path, gaussians)


def _background(dark: bool) -> Float[np.ndarray, "3"]:
    return np.zeros(3) if dark else np.ones(3)


def _check_size(camera: Camera) -> None:
    if not all(SMALLEST_SIDE <= side <= LARGEST_SIDE for side in camera.shape):
        raise InputError(
            f"An image has {SMALLEST_SIDE} to {LARGEST_SIDE} pixels in width and height, not "
            f"{camera.width} x {camera.height}."
        )
