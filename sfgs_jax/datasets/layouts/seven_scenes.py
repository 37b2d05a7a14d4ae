"""7-Scenes sequences: frame-XXXXXX.color.png, .depth.png and .pose.txt in one folder.

Source: Shotton et al., Scene Coordinate Regression Forests for Camera Relocalization in RGB-D Images,
CVPR 2013.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    DepthRegistration,
    FilePair,
    FileRecording,
    Intrinsics,
    depth_notes,
    first_readable,
    ground_truth_by_frame,
    read_camera_json,
    read_matrix_file,
    size_text,
)

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 1000.0
# The set comes without a calibration. These are the Kinect's nominal focal lengths.
_COLOUR = Intrinsics(525.0, 525.0, 320.0, 240.0)
_DEPTH = Intrinsics(585.0, 585.0, 320.0, 240.0)

T_COLOUR_DEPTH = np.array(
    [
        [0.99996744, -0.00784076, -0.0019093, -0.0205497],
        [0.0078317, 0.99995825, -0.00470726, 0.00190406],
        [0.00194613, 0.00469216, 0.9999871, -0.0049617],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""Extrinsics of the depth camera, found from the set's images by experiments/seven_scenes_calibration.py. The
generic extrinsics of later work on the set (DSAC*, ACE) put depth two to eleven pixels beside its colour."""

_NAME = re.compile(r"frame-(\d+)\.color\.(png|jpe?g)", re.IGNORECASE)


def matches(source: Path) -> bool:
    """True if the folder has frame-*.color.png or .jpg."""
    return bool(_colour_images(source))


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a 7-Scenes sequence. Arguments and errors as of `open_recording`.

    The depth image is drawn into the colour camera's view. The published poses are the depth camera's; they
    are turned into the colour camera's.
    """
    colour = _colour_images(source)
    pairs = [
        FilePair(path, source / f"frame-{digits}.depth.png", int(digits) / _FRAMES_PER_SECOND)
        for digits, path in sorted(colour.items(), key=lambda item: int(item[0]))
    ]
    scale = options.depth_scale or _UNITS_PER_METRE
    rgb, depth = first_readable(source, pairs, scale)
    if rgb.shape[:2] != depth.shape:
        raise InputError(
            f"Colour images of {source} are {size_text(rgb)} but depth images are {size_text(depth)}; "
            "7-Scenes sequences have one size."
        )
    height, width = depth.shape
    intrinsics = read_camera_json(options.camera).pinhole(source) if options.camera else _COLOUR
    camera = intrinsics.camera(width, height, source)
    timestamps = np.asarray([pair.timestamp for pair in pairs])
    poses = [_pose(source / f"frame-{digits}.pose.txt") for digits in sorted(colour, key=int)]
    ground_truth, truth_notes = ground_truth_by_frame(poses, timestamps)
    return FileRecording(
        name=source.resolve().name,
        dataset="7scenes",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *depth_notes(depth), *truth_notes),
        register=DepthRegistration(_DEPTH.camera(width, height, source), camera, T_COLOUR_DEPTH),
    )


def _colour_images(source: Path) -> dict[str, Path]:
    """Colour images by the digits of their frame number."""
    if not source.is_dir():
        return {}
    found = ((_NAME.fullmatch(path.name), path) for path in source.iterdir())
    return {match[1]: path for match, path in found if match}


def _pose(path: Path) -> Float[np.ndarray, "4 4"] | None:
    """`T_world_colour` from a frame's pose file; None without one."""
    return read_matrix_file(path) @ np.linalg.inv(T_COLOUR_DEPTH) if path.is_file() else None
