"""A video with a folder of depth images: one video, depth/, camera.json, and optionally poses.txt."""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    DEPTH_SUFFIXES,
    VIDEO_SUFFIXES,
    FilePair,
    FileRecording,
    Video,
    VideoFrame,
    common_view,
    ground_truth_of_file,
    images_in,
    own_camera,
)


def matches(source: Path) -> bool:
    """True if the folder has a video and depth/."""
    return (source / "depth").is_dir() and bool(images_in(source, VIDEO_SUFFIXES))


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a video with depth. Arguments and errors as of `open_recording`."""
    videos = images_in(source, VIDEO_SUFFIXES)
    if len(videos) != 1:
        names = ", ".join(path.name for path in videos) or "none"
        raise InputError(f"{source} should have one video, but has {names}.")
    intrinsics = own_camera(source, options.camera)
    scale = options.depth_scale or intrinsics.depth_scale
    video = Video(videos[0])
    depth = images_in(source / "depth", DEPTH_SUFFIXES)
    numbers = _frame_numbers(source, depth, video.num_frames)
    rate = intrinsics.fps or video.frames_per_second
    pairs = [
        FilePair(VideoFrame(video, n), path, n / rate)
        for n, path in sorted(zip(numbers, depth, strict=True))
        if n < video.num_frames
    ]
    beyond = len(depth) - len(pairs)
    notes = [f"{beyond} of {len(depth)} depth images lie beyond the end of the video."] if beyond else []
    view = common_view(source, pairs, scale, intrinsics)
    timestamps = np.asarray([pair.timestamp for pair in pairs], np.float64)
    ground_truth, truth_notes = ground_truth_of_file(
        source / "poses.txt", timestamps, options.association_limit
    )
    return FileRecording(
        name=source.resolve().name,
        dataset="video",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *notes, *view.notes, *truth_notes),
        register=view.register,
    )


def _frame_numbers(source: Path, depth: list[Path], num_frames: int) -> list[int]:
    """Video frame of each depth image: the number that it is named by, else its place."""
    if all(path.stem.isdecimal() for path in depth):
        numbers = [int(path.stem) for path in depth]
        # Tools that cut a video into images count from 1.
        first = 1 if numbers and min(numbers) == 1 and max(numbers) == num_frames else 0
        return [number - first for number in numbers]
    if len(depth) != num_frames:
        raise InputError(
            f"{source} has {num_frames} video frames and {len(depth)} depth images; name each depth image by "
            "the number of its frame."
        )
    return list(range(len(depth)))
