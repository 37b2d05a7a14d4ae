"""Images as data URLs, so that a page holds them itself."""

import base64

import cv2
import numpy as np
from jaxtyping import Float, UInt8

_WIDTH = 400
"""Largest width, pixels: a quarter of the page on a dense screen."""

LARGEST_ERROR = 0.25
"""Error of colour that is shown white."""


def rgb_picture(image: Float[np.ndarray, "H W 3"]) -> str:
    """An RGB image in [0, 1] as a JPEG data URL."""
    return _encode((np.clip(image, 0, 1) * 255).round().astype(np.uint8))


def depth_picture(depth: Float[np.ndarray, "H W"], near: float, far: float) -> str:
    """Depth in false colours as a JPEG data URL; missing depth is black.

    Args:
        depth: metres, 0 where missing.
        near: depth of the first colour (red), metres.
        far: depth of the last colour (blue), metres.
    """
    level = np.clip((depth - near) / max(far - near, 1e-6), 0, 1)
    return _encode(np.where((depth > 0)[..., None], _colours(level), 0).astype(np.uint8))


def error_picture(error: Float[np.ndarray, "H W 3"]) -> str:
    """Size of an error of colour as a grey JPEG data URL; white from `LARGEST_ERROR` on.

    Args:
        error: difference of two images in [0, 1].
    """
    size = np.clip(np.abs(error).mean(axis=2) / LARGEST_ERROR, 0, 1)
    return _encode(np.repeat((255 * size).round().astype(np.uint8)[..., None], 3, axis=2))


def depth_scale() -> str:
    """The false colours from near to far, as a JPEG data URL."""
    return _encode(_colours(np.tile(np.linspace(0, 1, 256), (8, 1))))


def _colours(level: Float[np.ndarray, "H W"]) -> UInt8[np.ndarray, "H W 3"]:
    """Turbo colours of levels in [0, 1]: 0 is red, 1 is blue."""
    mapped = cv2.applyColorMap(((1 - level) * 255).round().astype(np.uint8), cv2.COLORMAP_TURBO)
    return np.asarray(mapped[..., ::-1])


def _encode(image: UInt8[np.ndarray, "H W 3"]) -> str:
    height, width = image.shape[:2]
    if width > _WIDTH:
        size = (_WIDTH, max(round(height * _WIDTH / width), 1))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 88])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()
