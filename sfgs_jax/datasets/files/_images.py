"""Image files: decoding colour and depth to float32, and depth back to 16-bit units."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Shaped, UInt16

from sfgs_jax.arrays import FrameError

COLOUR_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff", ".webp", ".ppm")
"""Endings of colour images."""

DEPTH_SUFFIXES = (".png", ".npy", ".tif", ".tiff", ".pgm")
"""Endings of depth images."""

# A saturated sensor value means "too far or unknown" in 7-Scenes and in every other 16-bit layout.
_SATURATED = 65535


def decode_colour(path: Path) -> Float[np.ndarray, "h w 3"]:
    """RGB in [0, 1]. Grey images become grey RGB; an orientation tag is ignored, because depth has none.

    Raises:
        FrameError: the file can't be read, is truncated or is no image.
    """
    image = _decode(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    return np.multiply(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), np.float32(1 / 255), dtype=np.float32)


def decode_depth(path: Path, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
    """Depth in metres; 0 where it is missing (0, saturated, negative or not finite).

    Args:
        path: a 16-bit or floating-point image of one channel, or a two-dimensional `.npy` array.
        units_per_metre: divisor; None means 1000 for integers and 1 for floating point.

    Raises:
        FrameError: the file can't be read, is truncated, or isn't such an image.
    """
    if path.suffix.lower() == ".npy":
        try:
            image = np.load(path, allow_pickle=False)
        except (OSError, ValueError, EOFError) as error:
            raise FrameError(f"{path} cannot be read as an array: {error}.") from error
    else:
        image = _decode(path, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION)
    if image.ndim != 2:
        raise FrameError(f"{path} has shape {image.shape}; a depth image has one channel.")
    if image.dtype == np.uint8:
        raise FrameError(f"{path} has 8 bits; save depth as 16-bit PNG, or as floating point in metres.")
    if np.issubdtype(image.dtype, np.integer):
        scale = np.float32(1 / (units_per_metre or 1000.0))
        depth = np.multiply(image, scale, dtype=np.float32, casting="unsafe")
        if image.dtype == np.uint16:
            depth[image == _SATURATED] = 0
        return np.maximum(depth, 0)
    if not np.issubdtype(image.dtype, np.floating):
        raise FrameError(f"{path} holds {image.dtype} values; depth must be integer or floating point.")
    depth = image.astype(np.float32) * np.float32(1 / (units_per_metre or 1.0))
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))


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


def _decode(path: Path, flags: int) -> Shaped[np.ndarray, "h w *channels"]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path} cannot be read: {error.strerror or error}.") from error
    # Some OpenCV versions return the upper part of a truncated file without complaint.
    if not _is_whole(data):
        raise FrameError(f"{path} is truncated ({len(data)} bytes).")
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error as error:
        raise FrameError(f"{path} cannot be decoded: {error.err}.") from error
    if image is None:
        raise FrameError(f"{path} is damaged or is not an image.")
    return image


def _is_whole(data: bytes) -> bool:
    """True if a PNG or JPEG file has an end marker in its second half; a thumbnail's marker is earlier."""
    if data.startswith(b"\x89PNG"):
        return data.rfind(b"IEND") > len(data) // 2
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") > len(data) // 2
    return len(data) > 0
