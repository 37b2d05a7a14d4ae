"""Bringing colour and depth of one camera, stored at different sizes, to one size.

Phones store depth that is registered to colour, at a fraction of its size: 256x192 beside 1920x1440.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets.files._camera_files import Intrinsics
from sfgs_jax.datasets.files._file_recording import (
    FilePair,
    PairRegistration,
    depth_notes,
    first_readable,
    size_text,
)
from sfgs_jax.geometry import Camera

# Keypoints need this many pixels along the longer side; more than this cost time and gain little.
_LONGER_SIDE = 640
# Stored sizes are rounded, so their ratios differ a little: 256x192 and 1296x968 by 0.4 %.
_ASPECT_TOLERANCE = 0.02
# Neighbouring depths that differ by more lie on two surfaces, and between them lies none.
_LARGEST_STEP = 0.1


@dataclass(frozen=True)
class CommonView:
    """The camera that both images of each frame are brought to.

    Attributes:
        camera: its intrinsics and size.
        register: brings a decoded pair to it; None if there is nothing to do.
        notes: warnings for the log.
    """

    camera: Camera
    register: PairRegistration | None
    notes: tuple[str, ...]


def common_view(
    source: Path, pairs: Sequence[FilePair], units_per_metre: float | None, intrinsics: Intrinsics
) -> CommonView:
    """The camera of a recording whose depth is registered to colour, but may have another size.

    Images of one size keep it. Otherwise colour is scaled down until its longer side is that of depth, but
    at least 640 pixels. Depth is brought to the same size. Lens distortion is taken out after that.

    Args:
        source: the recording, for messages.
        pairs: its images.
        units_per_metre: as in `decode_depth`.
        intrinsics: of colour, at the size at which it is stored.

    Raises:
        InputError: as `first_readable` and `Intrinsics.camera`; or depth has another aspect ratio.
    """
    rgb, depth = first_readable(source, pairs, units_per_metre)
    colour_size, depth_size = (rgb.shape[1], rgb.shape[0]), (depth.shape[1], depth.shape[0])
    stored = intrinsics.camera(*colour_size, source)
    notes = depth_notes(depth)
    if colour_size == depth_size:
        return CommonView(stored, intrinsics.undistortion(stored), notes)
    ratio = colour_size[0] * depth_size[1] / (colour_size[1] * depth_size[0])
    if abs(ratio - 1) > _ASPECT_TOLERANCE:
        raise InputError(
            f"Colour images of {source} are {size_text(rgb)} but depth images are {size_text(depth)}, "
            "which is another aspect ratio; register depth to the colour camera."
        )
    size = working_size(colour_size, depth_size)
    scaled = scaled_intrinsics(intrinsics, colour_size, size)
    camera = scaled.camera(*size, source)
    resizing = _Resizing(colour_size, size, scaled.undistortion(camera))
    return CommonView(camera, resizing, notes)


def working_size(colour_size: tuple[int, int], depth_size: tuple[int, int]) -> tuple[int, int]:
    """Width and height of colour whose longer side is that of depth, but at least 640 and not enlarged."""
    scale = min(1.0, max(_LONGER_SIDE, *depth_size) / max(colour_size))
    return round(colour_size[0] * scale), round(colour_size[1] * scale)


def scaled_intrinsics(intrinsics: Intrinsics, old: tuple[int, int], new: tuple[int, int]) -> Intrinsics:
    """Intrinsics of an image scaled from one size (width, height) to another."""
    u, v = new[0] / old[0], new[1] / old[1]
    return replace(
        intrinsics,
        fx=intrinsics.fx * u,
        fy=intrinsics.fy * v,
        # Pixel centres lie at integers, so the image begins half a pixel before 0.
        cx=(intrinsics.cx + 0.5) * u - 0.5,
        cy=(intrinsics.cy + 0.5) * v - 0.5,
        width=None,
        height=None,
    )


def resized_depth(depth: Float[np.ndarray, "h w"], size: tuple[int, int]) -> Float[np.ndarray, "h2 w2"]:
    """Depth of the same view at another size, without points between surfaces.

    On a surface it is bilinear in inverse depth, which is exact on planes. Beside a hole or a step in depth
    it is the nearest pixel's.

    Args:
        depth: metres, 0 where missing.
        size: width and height of the result.
    """
    if (depth.shape[1], depth.shape[0]) == size:
        return depth
    nearest = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST_EXACT)
    if size[0] < depth.shape[1]:
        return np.asarray(nearest, np.float32)
    inverse = np.where(depth > 0, 1 / np.where(depth > 0, depth, 1), 0).astype(np.float32)
    window = np.ones((3, 3), np.uint8)
    low = cv2.erode(inverse, window, borderType=cv2.BORDER_REPLICATE)
    high = cv2.dilate(inverse, window, borderType=cv2.BORDER_REPLICATE)
    surface = (high - low <= _LARGEST_STEP * high) & (depth > 0)
    smooth = cv2.resize(inverse, size, interpolation=cv2.INTER_LINEAR)
    surface = cv2.resize(surface.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT) > 0
    return np.where(surface, 1 / np.where(surface, smooth, 1), nearest).astype(np.float32)


class _Resizing:
    """Brings the images of a pair to one size, then takes the lens out."""

    def __init__(
        self, colour_size: tuple[int, int], size: tuple[int, int], undistortion: PairRegistration | None
    ) -> None:
        self._colour_size = colour_size
        self._size = size
        self._undistortion = undistortion
        self.valid = None if undistortion is None else undistortion.valid

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h3 w3 3"], Float[np.ndarray, "h3 w3"]]:
        if rgb.shape[:2] != self._colour_size[::-1]:
            expected = "x".join(map(str, self._colour_size))
            raise FrameError(f"A colour image is {size_text(rgb)}, other than the first frame's {expected}.")
        if self._colour_size != self._size:
            rgb = np.asarray(cv2.resize(rgb, self._size, interpolation=cv2.INTER_AREA), np.float32)
        depth = resized_depth(depth, self._size)
        return self._undistortion(rgb, depth) if self._undistortion is not None else (rgb, depth)
