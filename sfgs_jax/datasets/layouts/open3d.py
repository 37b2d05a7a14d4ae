"""The layout of Open3D's reconstruction system and recorders: color/, depth/, intrinsic.json, trajectory.log.

Source: Open3D's tutorial on its reconstruction system, and the Redwood format of trajectories. Depth is
registered to colour, in millimetres.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    COLOUR_SUFFIXES,
    DEPTH_SUFFIXES,
    FilePair,
    FileRecording,
    Intrinsics,
    ground_truth_by_frame,
    images_in,
    matched_images,
    read_camera_json,
    read_json,
    read_numbers,
    registered_size,
    rigid_poses,
    times_of_names,
)

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 1000.0
_COLOUR_FOLDERS = ("color", "rgb", "image")
_CAMERA_FILES = ("intrinsic.json", "camera_intrinsic.json", "camera_primesense.json")
_TRAJECTORIES = ("trajectory.log", "scene/trajectory.log")


def matches(source: Path) -> bool:
    """True if the folder has color/, depth/ and a camera file of Open3D, and is no plain folder."""
    images = _colour_folder(source) is not None and (source / "depth").is_dir()
    plain = (source / "rgb").is_dir() and (source / "camera.json").is_file()
    return images and not plain and _camera_file(source) is not None


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a recording of Open3D. Arguments and errors as of `open_recording`."""
    folder, camera_file = _colour_folder(source), _camera_file(source)
    if folder is None or camera_file is None:
        raise InputError(f"{source} has no color/ or no intrinsic.json.")
    intrinsics = read_camera_json(options.camera) if options.camera else _intrinsics(camera_file)
    scale = options.depth_scale or _UNITS_PER_METRE
    colour, depth = images_in(folder, COLOUR_SUFFIXES), images_in(source / "depth", DEPTH_SUFFIXES)
    matched, match_notes = matched_images(source, colour, depth)
    timestamps = times_of_names([pair[0] for pair in matched], _FRAMES_PER_SECOND)
    pairs = [FilePair(*pair, time) for pair, time in zip(matched, timestamps.tolist(), strict=True)]
    width, height, depth_notes = registered_size(source, pairs, scale)
    known = _trajectory(source)
    ground_truth, truth_notes = ground_truth_by_frame([known.get(n) for n in range(len(pairs))], timestamps)
    camera = intrinsics.camera(width, height, source)
    return FileRecording(
        name=source.resolve().name,
        dataset="open3d",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *match_notes, *depth_notes, *truth_notes),
        register=intrinsics.undistortion(camera),
    )


def _colour_folder(source: Path) -> Path | None:
    return next((source / name for name in _COLOUR_FOLDERS if (source / name).is_dir()), None)


def _camera_file(source: Path) -> Path | None:
    return next((source / name for name in _CAMERA_FILES if (source / name).is_file()), None)


def _intrinsics(path: Path) -> Intrinsics:
    """The camera file: width, height, and the calibration matrix column by column."""
    content = read_json(path)
    try:
        K = [float(value) for value in content["intrinsic_matrix"]]
        width, height = int(content["width"]), int(content["height"])
        if len(K) != 9:
            raise ValueError(f"intrinsic_matrix has {len(K)} numbers")
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path} does not hold width, height and the 9 numbers of intrinsic_matrix ({excerpt(error)})."
        ) from error
    return Intrinsics(K[0], K[4], K[6], K[7], width=width, height=height)


def _trajectory(source: Path) -> dict[int, Float[np.ndarray, "4 4"]]:
    """`T_world_cam` by frame number: for each, a line of three numbers and four lines of a 4x4 matrix."""
    path = next((source / name for name in _TRAJECTORIES if (source / name).is_file()), None)
    if path is None:
        return {}
    rows = read_numbers(path)
    numbers, matrices = rows[::5], [row for i, row in enumerate(rows) if i % 5]
    if len(rows) % 5 or any(len(row) != 4 for row in matrices) or any(len(row) != 3 for row in numbers):
        raise InputError(f"{path} should have three numbers and a 4x4 matrix for each frame.")
    if not all(number[0].is_integer() for number in numbers):
        raise InputError(f"{path} should begin each frame with its number, a whole one.")
    poses = rigid_poses(np.asarray(matrices, np.float64).reshape(-1, 4, 4))
    return {int(number[0]): pose for number, pose in zip(numbers, poses, strict=True)}
