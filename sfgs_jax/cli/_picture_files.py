"""Pictures to files: a folder of PNG images, a video, or an animated image."""

import io
import os
import tempfile
from pathlib import Path
from types import TracebackType

import cv2
import numpy as np
import PIL.Image
from jaxtyping import Float, Shaped, UInt8, UInt16

from sfgs_jax.arrays import InputError, put_in_place, write_atomically

VIDEO_SUFFIX = ".mp4"
"""Ending of the videos that can be written."""

ANIMATION_SUFFIXES = (".gif", ".webp")
"""Endings of animated images, which web pages show like any other image."""

_WEBP_QUALITY = 70


class PngFolder:
    """Numbered PNG images in a folder, `000000.png` and on.

    Args:
        folder: made if it isn't there.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._count = folder, 0

    def __enter__(self) -> "PngFolder":
        self._folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def write(self, picture: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w"]) -> None:
        """Write the next image."""
        path = self._folder / f"{self._count:06d}.png"
        self._count += 1
        _, data = cv2.imencode(".png", picture[..., ::-1] if picture.ndim == 3 else picture)
        write_atomically(path, data.tobytes(), sync_name=False)


class VideoFile:
    """A video in MP4 (MPEG-4 part 2), of RGB pictures of one size.

    Args:
        path: the file; it appears when the video is whole.
        frames_per_second: rate.
    """

    def __init__(self, path: Path, frames_per_second: float) -> None:
        self._path, self._rate = path, frames_per_second
        self._part: Path | None = None
        self._writer: cv2.VideoWriter | None = None

    def __enter__(self) -> "VideoFile":
        handle, name = tempfile.mkstemp(
            dir=self._path.parent, prefix=f".{self._path.stem}.", suffix=VIDEO_SUFFIX
        )
        os.close(handle)
        self._part = Path(name)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.release()
        if self._part is None:
            return
        if kind is None and self._writer is not None:
            put_in_place(self._part, self._path)
        else:
            self._part.unlink()

    def write(self, picture: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w"]) -> None:
        """Add a picture.

        Raises:
            InputError: this OpenCV can't encode MP4.
        """
        if self._writer is None:
            self._writer = self._opened(picture.shape[1], picture.shape[0])
        self._writer.write(np.ascontiguousarray(picture[..., ::-1]))

    def _opened(self, width: int, height: int) -> cv2.VideoWriter:
        code = cv2.VideoWriter.fourcc(*"mp4v")
        writer = cv2.VideoWriter(str(self._part), code, self._rate, (width, height))
        if not writer.isOpened():
            raise InputError(
                f"This OpenCV has no encoder for {VIDEO_SUFFIX}: give a folder to --out and make the video "
                "from its images, for example with ffmpeg."
            )
        return writer


class AnimationFile:
    """An animated GIF or WebP that repeats, of RGB pictures of one size; it is held in memory until the end.

    GIF has 256 colours for all pictures together, WebP all colours in a smaller file.

    Args:
        path: the file, `.gif` or `.webp`; it appears when the animation is whole.
        frames_per_second: rate. A GIF's pictures last whole hundredths of a second.
    """

    def __init__(self, path: Path, frames_per_second: float) -> None:
        self._path, self._rate = path, frames_per_second
        self._pictures: list[PIL.Image.Image] = []

    def __enter__(self) -> "AnimationFile":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None or not self._pictures:
            return
        gif = self._path.suffix.lower() == ".gif"
        first, *others = _with_one_palette(self._pictures) if gif else self._pictures
        content = io.BytesIO()
        first.save(
            content,
            format="GIF" if gif else "WEBP",
            save_all=True,
            append_images=others,
            duration=round(1000 / self._rate),
            loop=0,
            quality=_WEBP_QUALITY,
        )
        write_atomically(self._path, content.getvalue())

    def write(self, picture: UInt8[np.ndarray, "h w 3"] | UInt16[np.ndarray, "h w"]) -> None:
        """Add a picture."""
        self._pictures.append(PIL.Image.fromarray(picture))


def _with_one_palette(pictures: list[PIL.Image.Image]) -> list[PIL.Image.Image]:
    """Pictures in 256 colours that suit a sample of them; colours that change would flicker."""
    width, height = pictures[0].size
    sample = pictures[:: max(1, len(pictures) // 8)]
    strip = PIL.Image.new("RGB", (width, height * len(sample)))
    for place, picture in enumerate(sample):
        strip.paste(picture, (0, height * place))
    palette = strip.quantize(256, dither=PIL.Image.Dither.NONE)
    return [picture.quantize(palette=palette, dither=PIL.Image.Dither.NONE) for picture in pictures]


def rgb_levels(rgb: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """An RGB image in [0, 1] in 8 bits; values outside are clipped."""
    return np.round(np.clip(rgb, 0, 1) * 255).astype(np.uint8)


def false_colours(depth: Float[np.ndarray, "h w"], far: float) -> UInt8[np.ndarray, "h w 3"]:
    """Depth in Turbo's colours, red at 0 and blue from `far` metres on; missing depth is black."""
    level = np.round(255 * (1 - np.clip(depth / far, 0, 1))).astype(np.uint8)
    colours = np.asarray(cv2.applyColorMap(level, cv2.COLORMAP_TURBO), np.uint8)[..., ::-1]
    return np.where((depth > 0)[..., None], colours, np.uint8(0))


def normal_colours(normals: Shaped[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Normals in camera axes as colours: x right, y up and z backward from 0 to 255, as is usual.

    Zeros, where there is no surface, are black.
    """
    levels = np.round(255 * (0.5 + 0.5 * normals * np.asarray([1, -1, -1]))).astype(np.uint8)
    return np.where(np.any(normals != 0, axis=-1, keepdims=True), levels, np.uint8(0))
