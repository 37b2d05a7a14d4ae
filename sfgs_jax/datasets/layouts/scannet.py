"""ScanNet scans, exported to frames: color/N.jpg, depth/N.png, pose/N.txt, intrinsic/intrinsic_*.txt.

Source: Dai et al., ScanNet, CVPR 2017, and the export of its SensReader.

Colour (1296x968) and depth (640x480) have their own cameras, which share one position and orientation. So
colour is brought to the depth camera exactly: it is scaled down and moved by the difference that remains
between the two calibrations. That is about 3 pixels, which the usual plain scaling ignores.
"""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    CAMERA_EXAMPLE,
    COLOUR_SUFFIXES,
    FilePair,
    FileRecording,
    Intrinsics,
    depth_notes,
    first_readable,
    ground_truth_by_frame,
    images_by_number,
    read_camera_json,
    read_matrix_file,
    read_numbers,
    scaled_intrinsics,
    size_text,
)

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 1000.0


def matches(source: Path) -> bool:
    """True if the folder has color/ and depth/."""
    return (source / "color").is_dir() and (source / "depth").is_dir()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a ScanNet scan. Arguments and errors as of `open_recording`."""
    scale = options.depth_scale or _UNITS_PER_METRE
    colour, depth = (
        images_by_number(source / "color", "", COLOUR_SUFFIXES),
        images_by_number(source / "depth", "", (".png",)),
    )
    numbers = sorted(colour.keys() & depth.keys())
    pairs = [FilePair(colour[n], depth[n], n / _FRAMES_PER_SECOND) for n in numbers]
    first_rgb, first_depth = first_readable(source, pairs, scale)
    depth_size = (first_depth.shape[1], first_depth.shape[0])
    colour_size = (first_rgb.shape[1], first_rgb.shape[0])
    intrinsics, colour_to_depth = _intrinsics(source, options, colour_size, depth_size)
    poses = [_pose(source / "pose" / f"{n}.txt") for n in numbers]
    ground_truth, truth_notes = ground_truth_by_frame(poses, np.asarray(numbers) / _FRAMES_PER_SECOND)
    return FileRecording(
        name=source.resolve().name,
        dataset="scannet",
        camera=intrinsics.camera(*depth_size, source),
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *depth_notes(first_depth), *truth_notes),
        register=_Resize(colour_size, depth_size, colour_to_depth),
    )


class _Resize:
    """Brings colour images into the depth camera."""

    def __init__(
        self,
        colour_size: tuple[int, int],
        depth_size: tuple[int, int],
        colour_to_depth: Float[np.ndarray, "2 3"] | None,
    ) -> None:
        self._colour_size = colour_size
        self._depth_size = depth_size
        self._colour_to_depth = colour_to_depth
        self.valid = None
        if colour_to_depth is not None:
            seen = np.ones(depth_size[::-1], np.float32)
            self.valid = cv2.warpAffine(seen, colour_to_depth, depth_size, flags=cv2.INTER_LINEAR) == 1

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h2 w2 3"], Float[np.ndarray, "h2 w2"]]:
        if rgb.shape[:2] != self._colour_size[::-1]:
            expected = "x".join(map(str, self._colour_size))
            raise FrameError(f"A colour image is {size_text(rgb)}, other than the first frame's {expected}.")
        if self._colour_size != self._depth_size:
            rgb = cv2.resize(rgb, self._depth_size, interpolation=cv2.INTER_AREA)
        if self._colour_to_depth is not None:
            rgb = cv2.warpAffine(
                rgb,
                self._colour_to_depth,
                self._depth_size,
                flags=cv2.INTER_LINEAR,
                borderMode=cv2.BORDER_REPLICATE,
            )
        return np.asarray(rgb, np.float32), depth


def _intrinsics(
    source: Path, options: ReaderOptions, colour_size: tuple[int, int], depth_size: tuple[int, int]
) -> tuple[Intrinsics, Float[np.ndarray, "2 3"] | None]:
    """Intrinsics of the depth camera, and the affine map from the scaled colour image to its pixels."""
    if options.camera is not None:
        return read_camera_json(options.camera).pinhole(source), None
    depth_file = source / "intrinsic" / "intrinsic_depth.txt"
    colour_file = source / "intrinsic" / "intrinsic_color.txt"
    if colour_size == depth_size and depth_file.is_file():
        return _read_matrix(depth_file), None  # resized before; nothing says from which calibration
    if not colour_file.is_file():
        raise InputError(
            f"Intrinsics of {source} are missing: there is no {colour_file}; "
            f"export them with the frames, or give a camera.json such as {CAMERA_EXAMPLE}."
        )
    colour = _read_matrix(colour_file)
    colour.camera(*colour_size, source)  # is of colour's size, or says so
    scaled = scaled_intrinsics(colour, colour_size, depth_size)
    if not depth_file.is_file():
        return scaled, None
    depth = _read_matrix(depth_file)
    zoom_u, zoom_v = depth.fx / scaled.fx, depth.fy / scaled.fy
    shift = (depth.cx - zoom_u * scaled.cx, depth.cy - zoom_v * scaled.cy)
    return depth, np.array([[zoom_u, 0, shift[0]], [0, zoom_v, shift[1]]])


def _read_matrix(path: Path) -> Intrinsics:
    rows = read_numbers(path)
    if len(rows) not in (3, 4) or any(len(row) != len(rows) for row in rows):
        raise InputError(f"{path} should hold a 3x3 or 4x4 calibration matrix.")
    return Intrinsics(rows[0][0], rows[1][1], rows[0][2], rows[1][2])


def _pose(path: Path) -> Float[np.ndarray, "4 4"] | None:
    return read_matrix_file(path) if path.is_file() else None
