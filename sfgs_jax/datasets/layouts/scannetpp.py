"""The iPhone's part of a ScanNet++ scene: pose_intrinsic_imu.json, depth/, and rgb/ or its video.

Source: Yeshwanth et al., ScanNet++, ICCV 2023, and the exports of its toolkit. Depth is registered to
colour, in millimetres and a fraction of its size. Poses are of cameras with OpenCV's axes.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    COLOUR_SUFFIXES,
    ColourImage,
    FilePair,
    FileRecording,
    Intrinsics,
    Video,
    VideoFrame,
    check_increasing,
    common_view,
    ground_truth_by_frame,
    images_by_number,
    one_camera,
    read_camera_json,
    read_json,
    rigid_poses,
)

_UNITS_PER_METRE = 1000.0
_FILE = "pose_intrinsic_imu.json"
_VIDEOS = ("rgb.mkv", "rgb.mp4")


def matches(source: Path) -> bool:
    """True if the folder, or iphone/ in it, has pose_intrinsic_imu.json."""
    return _root(source) is not None


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a ScanNet++ scene. Arguments and errors as of `open_recording`."""
    root = _root(source)
    if root is None:
        raise InputError(f"{source} has no {_FILE}.")
    scale = options.depth_scale or _UNITS_PER_METRE
    entries = _entries(root / _FILE)
    depth = images_by_number(root / "depth", "frame_", (".png",))
    if not depth:
        raise InputError(f"{root} has no depth/frame_*.png; export them with the toolkit of ScanNet++.")
    colour = _colour(root, sorted(depth))
    numbers = [n for n in sorted(colour) if n in entries]
    timestamps = np.asarray([_number(entries[n], "timestamp", root) for n in numbers], np.float64)
    check_increasing(timestamps, root / _FILE)
    pairs = [
        FilePair(colour[n], depth[n], time) for n, time in zip(numbers, timestamps.tolist(), strict=True)
    ]
    if not pairs:
        raise InputError(f"No frame of {root} has a colour image, a depth image and an entry in {_FILE}.")
    if options.camera is not None:
        intrinsics = read_camera_json(options.camera)
    else:
        intrinsics = one_camera([_intrinsics(entries[n], root) for n in numbers], source)
    view = common_view(source, pairs, scale, intrinsics)
    poses = [_pose(entries[n], root) for n in numbers]
    ground_truth, truth_notes = ground_truth_by_frame(poses, timestamps)
    left_out = len(depth) - len(pairs)
    notes = (
        [f"{left_out} of {len(depth)} depth images have no colour or no entry in {_FILE}."]
        if left_out
        else []
    )
    folder = root.resolve()
    return FileRecording(
        name=folder.parent.name if folder.name == "iphone" else folder.name,
        dataset="scannetpp",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *notes, *view.notes, *truth_notes),
        register=view.register,
    )


def _root(source: Path) -> Path | None:
    """The folder that holds the iPhone's part."""
    folders = (source, source / "iphone")
    return next((folder for folder in folders if (folder / _FILE).is_file()), None)


def _entries(path: Path) -> dict[int, dict[str, Any]]:
    """Entry of each frame, by its number."""
    entries = {}
    for name, entry in read_json(path).items():
        number = re.fullmatch(r"frame_(\d{1,9})", name)
        if number is None or not isinstance(entry, dict):
            raise InputError(
                f"{path}: expected entries 'frame_000000' with pose and intrinsic, found {excerpt(name)}."
            )
        entries[int(number[1])] = entry
    return entries


def _colour(root: Path, numbers: list[int]) -> Mapping[int, Path | ColourImage]:
    """Colour of the frames of these numbers: images, or else frames of the video."""
    images = images_by_number(root / "rgb", "frame_", COLOUR_SUFFIXES)
    if images:
        return {n: images[n] for n in numbers if n in images}
    path = next((root / name for name in _VIDEOS if (root / name).is_file()), None)
    if path is None:
        raise InputError(f"{root} has no rgb/frame_*.jpg and no rgb.mkv.")
    video = Video(path)
    return {n: VideoFrame(video, n) for n in numbers if n < video.num_frames}


def _number(entry: dict[str, Any], key: str, root: Path) -> float:
    value = entry.get(key)
    if not isinstance(value, int | float) or not abs(value) < 1e12:
        raise InputError(f"{root / _FILE}: {key} of a frame should be a finite number, not {excerpt(value)}.")
    return float(value)


def _matrix(entry: dict[str, Any], key: str, side: int, root: Path) -> Float[np.ndarray, "n n"]:
    try:
        return np.asarray(entry[key], np.float64).reshape(side, side)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{root / _FILE}: {key} of a frame should be a {side}x{side} matrix.") from error


def _intrinsics(entry: dict[str, Any], root: Path) -> Intrinsics:
    K = _matrix(entry, "intrinsic", 3, root)
    return Intrinsics(float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))


def _pose(entry: dict[str, Any], root: Path) -> Float[np.ndarray, "4 4"] | None:
    key = "aligned_pose" if "aligned_pose" in entry else "pose"
    return rigid_poses(_matrix(entry, key, 4, root)[None])[0] if key in entry else None
