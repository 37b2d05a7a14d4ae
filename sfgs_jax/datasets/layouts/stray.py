"""Captures of the app Stray Scanner: rgb.mp4, depth/, confidence/, camera_matrix.csv, odometry.csv.

Source: the format's description by the app's authors (StrayRobots/scanner, docs/format.md).

Colour is a video. Depth is registered to it, in millimetres and a fraction of its size. The poses are
ARKit's, of a camera with OpenCV's axes in a world whose y points up.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Bool

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    ConfidentDepth,
    FilePair,
    FileRecording,
    Intrinsics,
    Video,
    VideoFrame,
    check_increasing,
    common_view,
    ground_truth_by_frame,
    images_by_number,
    quaternion_poses,
    read_camera_json,
    read_numbers,
    read_table,
)

_UNITS_PER_METRE = 1000.0
_COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")


def matches(source: Path) -> bool:
    """True if the folder has odometry.csv and depth/."""
    return (source / "odometry.csv").is_file() and (source / "depth").is_dir()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a Stray Scanner capture. Arguments and errors as of `open_recording`."""
    scale = options.depth_scale or _UNITS_PER_METRE
    intrinsics = read_camera_json(options.camera) if options.camera else _camera_matrix(source)
    video = Video(source / "rgb.mp4")
    depth = images_by_number(source / "depth", "", (".png",))
    confidence = images_by_number(source / "confidence", "", (".png",))
    rows = read_table(source / "odometry.csv", *_COLUMNS)
    rows = rows[np.isfinite(rows[:, :2]).all(axis=1)]
    complete = np.asarray([n in depth and n < video.num_frames for n in rows[:, 1].tolist()], bool)
    known = rows[complete]
    check_increasing(known[:, 0], source / "odometry.csv")
    pairs = []
    for timestamp, number in known[:, :2].tolist():
        n = int(number)
        image = (
            ConfidentDepth(depth[n], confidence[n], options.min_confidence) if n in confidence else depth[n]
        )
        pairs.append(FilePair(VideoFrame(video, n), image, timestamp))
    view = common_view(source, pairs, scale, intrinsics)
    poses = quaternion_poses(known[:, 2:5], known[:, 5:9])
    ground_truth, truth_notes = ground_truth_by_frame(list(poses), known[:, 0])
    return FileRecording(
        name=source.resolve().name,
        dataset="stray",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *_missing(complete), *view.notes, *truth_notes),
        register=view.register,
    )


def _camera_matrix(source: Path) -> Intrinsics:
    path = source / "camera_matrix.csv"
    rows = read_numbers(path)
    if [len(row) for row in rows] != [3, 3, 3]:
        raise InputError(f"{path} should hold a 3x3 calibration matrix.")
    return Intrinsics(rows[0][0], rows[1][1], rows[0][2], rows[1][2])


def _missing(complete: Bool[np.ndarray, " n"]) -> list[str]:
    count = len(complete) - int(complete.sum())
    if not count:
        return []
    return [f"{count} of {len(complete)} frames have no colour or no depth image and are left out."]
