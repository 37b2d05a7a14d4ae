"""Replica rooms as rendered for NICE-SLAM: results/frame*.jpg, results/depth*.png, traj.txt.

Source: Zhu et al., NICE-SLAM, CVPR 2022; the rendered trajectories are iMAP's (Sucar et al., ICCV 2021).
"""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError, excerpt, parsed_json
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    COLOUR_SUFFIXES,
    FilePair,
    FileRecording,
    Intrinsics,
    ground_truth_by_frame,
    images_by_number,
    read_camera_json,
    read_matrix_rows,
    read_text,
    registered_size,
)

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 6553.5
_DEFAULT = Intrinsics(600.0, 600.0, 599.5, 339.5, width=1200, height=680)


def matches(source: Path) -> bool:
    """True if the folder has results/frame*."""
    return bool(images_by_number(source / "results", "frame", COLOUR_SUFFIXES))


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a Replica room. Arguments and errors as of `open_recording`."""
    intrinsics = _intrinsics(source, options)
    scale = options.depth_scale or intrinsics.depth_scale or _UNITS_PER_METRE
    colour = images_by_number(source / "results", "frame", COLOUR_SUFFIXES)
    depth = images_by_number(source / "results", "depth", (".png",))
    numbers = sorted(colour.keys() & depth.keys())
    pairs = [FilePair(colour[n], depth[n], n / _FRAMES_PER_SECOND) for n in numbers]
    width, height, depth_notes = registered_size(source, pairs, scale)
    rows = read_matrix_rows(source / "traj.txt") if (source / "traj.txt").is_file() else np.zeros((0, 4, 4))
    # Lines have the images' numbers, also if some images were taken away.
    poses = [rows[n] if n < len(rows) else None for n in numbers]
    ground_truth, truth_notes = ground_truth_by_frame(poses, np.asarray(numbers) / _FRAMES_PER_SECOND)
    camera = intrinsics.camera(width, height, source)
    return FileRecording(
        name=source.resolve().name,
        dataset="replica",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *depth_notes, *truth_notes),
        register=intrinsics.undistortion(camera),
    )


def _intrinsics(source: Path, options: ReaderOptions) -> Intrinsics:
    if options.camera is not None:
        return read_camera_json(options.camera)
    for folder in (source, source.resolve().parent):
        if (folder / "cam_params.json").is_file():
            return _read_cam_params(folder / "cam_params.json")
    return _DEFAULT


def _read_cam_params(path: Path) -> Intrinsics:
    """NICE-SLAM's own camera file: {"camera": {"w", "h", "fx", "fy", "cx", "cy", "scale"}}."""
    try:
        camera = parsed_json(read_text(path))["camera"]
        return Intrinsics(
            fx=float(camera["fx"]),
            fy=float(camera["fy"]),
            cx=float(camera["cx"]),
            cy=float(camera["cy"]),
            depth_scale=float(camera["scale"]),
            width=int(camera["w"]),
            height=int(camera["h"]),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path} does not hold the camera's w, h, fx, fy, cx, cy and scale ({excerpt(error)}); "
            "correct it, or give a camera.json."
        ) from error
