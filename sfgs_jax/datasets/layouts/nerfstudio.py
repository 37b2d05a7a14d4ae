"""nerfstudio's transforms.json with depth, also as instant-ngp and NeRFCapture write it.

Source: nerfstudio's page on data conventions. Cameras have OpenGL's axes, principal points count from the
corner of the first pixel. Depth is in millimetres, or in units of `integer_depth_scale` metres.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    FilePair,
    FileRecording,
    Intrinsics,
    common_view,
    ground_truth_by_frame,
    listed_file,
    natural_key,
    one_camera,
    opencv_poses,
    read_camera_json,
    read_json,
    rigid_poses,
    times_of_names,
)

_FRAMES_PER_SECOND = 30.0
_FILE = "transforms.json"
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
_DEPTH_KEYS = ("depth_file_path", "depth_path")


def matches(source: Path) -> bool:
    """True if the folder has transforms.json."""
    return (source / _FILE).is_file()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a nerfstudio recording. Arguments and errors as of `open_recording`."""
    path = source / _FILE
    content = read_json(path)
    frames = _frames(content, path)
    with_depth = [frame for frame in frames if _depth_name(frame)]
    if not with_depth:
        raise InputError(f"{path} has no depth_file_path; add the depth image of each frame.")
    left_out = len(frames) - len(with_depth)
    notes = [f"{left_out} of {len(frames)} frames have no depth image and are left out."] if left_out else []
    colour = [_colour_file(source, frame, path) for frame in with_depth]
    depth = [listed_file(source, _depth_name(frame), path) for frame in with_depth]
    timestamps, time_notes = _timestamps(with_depth, colour)
    pairs = [FilePair(*row) for row in zip(colour, depth, timestamps.tolist(), strict=True)]
    scale = options.depth_scale or _units_per_metre(content, path)
    if options.camera is not None:
        intrinsics = read_camera_json(options.camera)
    else:
        intrinsics = one_camera([_intrinsics({**content, **frame}, path) for frame in with_depth], source)
    view = common_view(source, pairs, scale, intrinsics)
    ground_truth, truth_notes = ground_truth_by_frame(
        [_pose(frame, path) for frame in with_depth], timestamps
    )
    return FileRecording(
        name=source.resolve().name,
        dataset="nerfstudio",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*notes, *time_notes, *intrinsics.notes, *view.notes, *truth_notes),
        register=view.register,
    )


def _frames(content: dict[str, Any], path: Path) -> list[dict[str, Any]]:
    """The entries of frames, in order of time if all have one, else in natural order of their files."""
    frames = content.get("frames")
    if not isinstance(frames, list) or not all(
        isinstance(frame, dict) and isinstance(frame.get("file_path"), str) for frame in frames
    ):
        raise InputError(f"{path} should have a list 'frames' of objects with a file_path.")
    if frames and all(_time(frame) is not None for frame in frames):
        return sorted(frames, key=lambda frame: frame["timestamp"])
    return sorted(frames, key=lambda frame: natural_key(frame["file_path"]))


def _time(frame: dict[str, Any]) -> float | None:
    time = frame.get("timestamp")
    return float(time) if isinstance(time, int | float) and abs(time) < 1e12 else None


def _timestamps(
    frames: list[dict[str, Any]], colour: list[Path]
) -> tuple[Float[np.ndarray, " n"], tuple[str, ...]]:
    """Seconds: each frame's own, else as the files' names tell; and a note if frames have some of no use."""
    times = [time for time in map(_time, frames) if time is not None]
    if len(times) == len(frames) and len(set(times)) == len(times):
        return np.asarray(times, np.float64), ()
    given = any("timestamp" in frame for frame in frames)
    note = "Not every frame has a time stamp of its own in seconds, so they are not used."
    return times_of_names(colour, _FRAMES_PER_SECOND), (note,) if given else ()


def _depth_name(frame: dict[str, Any]) -> str:
    """Name of the depth image; empty without one."""
    names = (frame.get(key) for key in _DEPTH_KEYS)
    return next((name for name in names if isinstance(name, str) and name), "")


def _colour_file(source: Path, frame: dict[str, Any], path: Path) -> Path:
    file = listed_file(source, frame["file_path"], path)
    return file if file.suffix else file.with_suffix(".png")


def _units_per_metre(content: dict[str, Any], path: Path) -> float | None:
    metres = content.get("integer_depth_scale")
    if metres is None:
        return None
    if not isinstance(metres, int | float) or not 1e-9 < metres < 1e6:
        raise InputError(f"{path}: integer_depth_scale must be a positive number, not {excerpt(metres)}.")
    return 1 / metres


def _intrinsics(entries: dict[str, Any], path: Path) -> Intrinsics:
    """Intrinsics of a frame: its own entries, and the file's where it has none."""
    model = str(entries.get("camera_model", "OPENCV"))[:40]
    if model not in _MODELS or entries.get("is_fisheye"):
        raise InputError(f"{path}: cameras of the model {model} can't be read; undistort the images first.")
    try:
        width, height = int(entries["w"]), int(entries["h"])
        fx = float(entries["fl_x"]) if "fl_x" in entries else _focal(width, float(entries["camera_angle_x"]))
        distortion = tuple(float(entries.get(key) or 0) for key in ("k1", "k2", "p1", "p2", "k3"))
        intrinsics = Intrinsics(
            fx,
            float(entries.get("fl_y", fx)),
            # Here pixel centres lie at integers.
            float(entries.get("cx", width / 2)) - 0.5,
            float(entries.get("cy", height / 2)) - 0.5,
            width=width,
            height=height,
            distortion=distortion if any(distortion) else (),
        )
    except (KeyError, TypeError, ValueError, OverflowError, ZeroDivisionError) as error:
        raise InputError(
            f"{path} lacks the intrinsics fl_x, fl_y, cx, cy, w and h ({excerpt(error)})."
        ) from error
    if entries.get("k4"):
        raise InputError(f"{path}: the lens coefficient k4 can't be used; undistort the images first.")
    return intrinsics


def _focal(width: int, angle: float) -> float:
    """Focal length in pixels of a horizontal field of view in radians."""
    return width / 2 / math.tan(angle / 2)


def _pose(frame: dict[str, Any], path: Path) -> Float[np.ndarray, "4 4"] | None:
    """`T_world_cam` of a frame, NaN if it can't be used, None without one."""
    rows = frame.get("transform_matrix")
    if rows is None:
        return None
    try:
        pose = np.asarray(rows, np.float64)
        if pose.shape == (3, 4):
            pose = np.vstack([pose, [0, 0, 0, 1]])
        return opencv_poses(rigid_poses(pose.reshape(1, 4, 4)))[0]
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: transform_matrix of {excerpt(frame['file_path'])} should be a 4x4 matrix."
        ) from error
