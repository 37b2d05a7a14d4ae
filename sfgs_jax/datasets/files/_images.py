"""Images: decoding colour and depth to float32, and depth back to 16-bit units."""

import io
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt8, UInt16

from sfgs_jax.arrays import FrameError, excerpt, file_bytes, require_file

COLOUR_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm")
"""Endings of colour images."""

DEPTH_SUFFIXES = (".png", ".npy", ".tif", ".tiff", ".pgm")
"""Endings of depth images."""

# A saturated sensor value means "too far or unknown" in 7-Scenes and in every other 16-bit layout.
_SATURATED = 65535
# Larger than the images of any RGB-D camera. A damaged header may ask for more memory than there is.
MOST_PIXELS = 1 << 26
"""Pixels of the largest image that is read."""
_MOST_BYTES = 1 << 29
_FORMATS = ("PNG", "JPEG", "BMP", "PPM", "TIFF", "WEBP")
# Metres, which no camera sees. It is far above depth in a wrong unit, for which there is a note.
_FARTHEST = 1e6


@runtime_checkable
class ColourImage(Protocol):
    """A colour image that is no file of its own, such as a frame of a video. `str` names it in messages."""

    def rgb(self) -> Float[np.ndarray, "h w 3"]:
        """RGB in [0, 1]. Raises FrameError if it can't be decoded."""
        ...


@runtime_checkable
class DepthImage(Protocol):
    """A depth image that is no file of its own, such as one in an archive. `str` names it in messages."""

    def metres(self, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        """Depth in metres, 0 where missing. Raises FrameError if it can't be decoded.

        Args:
            units_per_metre: as in `decode_depth`.
        """
        ...


def decode_colour(image: Path | ColourImage) -> Float[np.ndarray, "h w 3"]:
    """RGB in [0, 1]. Grey images become grey RGB; an orientation tag is ignored, because depth has none.

    Args:
        image: an image file, or an image that decodes itself.

    Raises:
        FrameError: the image can't be read, is truncated or is no image.
    """
    if not isinstance(image, Path):
        return image.rgb()
    return colour_of_bytes(_read_bytes(image), str(image))


def colour_of_bytes(data: bytes, name: str) -> Float[np.ndarray, "h w 3"]:
    """RGB in [0, 1] of an encoded image.

    Args:
        data: the content of an image file.
        name: what to call it in an error.

    Raises:
        FrameError: the image is truncated or is none.
    """
    return colour_of_bgr(_decode(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION, name))


def colour_of_bgr(image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    """RGB in [0, 1] of an image with 8 bits a channel in OpenCV's order, blue first."""
    return np.multiply(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.float32(1 / 255), dtype=np.float32)


def decode_depth(image: Path | DepthImage, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
    """Depth in metres; 0 where it is missing (0, saturated, negative, not finite or beyond 1000 km).

    Args:
        image: a 16-bit or floating-point image file of one channel; a two-dimensional `.npy` array; or an
            image that decodes itself.
        units_per_metre: divisor; None means 1000 for integers and 1 for floating point.

    Raises:
        FrameError: the image can't be read, is truncated, or isn't such an image.
    """
    if not isinstance(image, Path):
        return image.metres(units_per_metre)
    if image.suffix.lower() != ".npy":
        return depth_of_bytes(_read_bytes(image), units_per_metre, str(image))
    return depth_of_array(_mapped_array(image), units_per_metre, str(image))


def depth_of_bytes(data: bytes, units_per_metre: float | None, name: str) -> Float[np.ndarray, "h w"]:
    """Depth in metres, 0 where missing, of an encoded image.

    Args:
        data: the content of an image file.
        units_per_metre: as in `decode_depth`.
        name: what to call it in an error.

    Raises:
        FrameError: the image is truncated, or is no depth image.
    """
    image = _decode(data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION, name)
    return depth_of_array(image, units_per_metre, name)


def depth_of_array(
    image: Shaped[np.ndarray, "..."], units_per_metre: float | None, name: str
) -> Float[np.ndarray, "h w"]:
    """Depth in metres, 0 where missing, of an array of units.

    Args:
        image: (h, w) integers of more than 8 bits, or floating point.
        units_per_metre: as in `decode_depth`.
        name: what to call it in an error.

    Raises:
        FrameError: the array is no depth image.
    """
    if image.ndim != 2:
        raise FrameError(f"{name} has shape {image.shape}; a depth image has one channel.")
    if image.dtype == np.uint8:
        raise FrameError(f"{name} has 8 bits; save depth as 16-bit PNG, or as floating point in metres.")
    if np.issubdtype(image.dtype, np.integer):
        scale = np.float32(1 / (units_per_metre or 1000.0))
        depth = np.multiply(image, scale, dtype=np.float32, casting="unsafe")
        if image.dtype == np.uint16:
            depth[image == _SATURATED] = 0
        return np.maximum(depth, 0)
    if not np.issubdtype(image.dtype, np.floating):
        raise FrameError(f"{name} holds {image.dtype} values; depth must be integer or floating point.")
    with np.errstate(over="ignore", invalid="ignore"):
        depth = image.astype(np.float32) * np.float32(1 / (units_per_metre or 1.0))
        return np.where((depth > 0) & (depth < _FARTHEST), depth, np.float32(0))


def depth_units(depth: Float[np.ndarray, "h w"], units_per_metre: float) -> UInt16[np.ndarray, "h w"]:
    """Depth as whole units of 16 bits, as `decode_depth` reads them back.

    Args:
        depth: metres.
        units_per_metre: factor.

    Returns:
        Units; 0 where depth is missing or beyond the range of 16 bits.
    """
    units = np.round(depth * units_per_metre)
    return np.where((units > 0) & (units < _SATURATED), units, 0).astype(np.uint16)


def read_levels(path: Path) -> UInt8[np.ndarray, "h w"]:
    """An image of one channel of 8 bits, such as a map of confidence.

    Raises:
        FrameError: the file can't be read, is truncated, or isn't such an image.
    """
    image = _decode(_read_bytes(path), cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION, str(path))
    if image.ndim != 2 or image.dtype != np.uint8:
        raise FrameError(f"{path} should have one channel of 8 bits, not {image.dtype} of {image.shape}.")
    return image


def _read_bytes(path: Path) -> bytes:
    try:
        return file_bytes(path, _MOST_BYTES)
    except (OSError, ValueError) as error:
        raise FrameError(f"{path} cannot be read: {excerpt(error)}.") from error


def _mapped_array(path: Path) -> np.ndarray:
    """The array of a .npy file, mapped into memory: a header that promises more than the file is refused."""
    try:
        require_file(path, _MOST_BYTES)
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # NumPy's reader raises whatever a broken header trips
        raise FrameError(f"{path} cannot be read as an array: {excerpt(error)}.") from error
    if not isinstance(array, np.ndarray):
        raise FrameError(f"{path} is an archive; save each depth image as an array of its own.")
    return array


def _decode(data: bytes, flags: int, name: str) -> Shaped[np.ndarray, "h w *channels"]:
    # Some OpenCV versions return the upper part of a truncated file without complaint.
    if not _is_whole(data):
        raise FrameError(f"{name} is truncated ({len(data)} bytes).")
    _require_size(data, name)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise FrameError(f"{name} cannot be decoded: {error.err}.") from error
    if image is None:
        raise FrameError(f"{name} is damaged or is not an image.")
    return image


def _require_size(data: bytes, name: str) -> None:
    """Raise FrameError if an image's header asks for more pixels than an image has, before room is made."""
    # Imported here, because it takes long and only files need it.
    from PIL import Image

    try:
        width, height = Image.open(io.BytesIO(data), formats=_FORMATS).size  # reads the header only
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise FrameError(f"{name} has more than {MOST_PIXELS} pixels.") from None
    except Exception:  # no image that it knows; the decoder has the last word
        return
    if width * height > MOST_PIXELS:
        raise FrameError(f"{name} has {width}x{height} pixels, more than {MOST_PIXELS}.")


def _is_whole(data: bytes) -> bool:
    """True if a PNG or JPEG file has an end marker in its second half; a thumbnail's marker is earlier."""
    if data.startswith(b"\x89PNG"):
        return data.rfind(b"IEND") > len(data) // 2
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") > len(data) // 2
    return len(data) > 0
