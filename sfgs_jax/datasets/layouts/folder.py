"""A plain folder: rgb/, depth/, camera.json, and optionally poses.txt."""

from pathlib import Path

from sfgs_jax.arrays import InputError
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    COLOUR_SUFFIXES,
    DEPTH_SUFFIXES,
    FilePair,
    FileRecording,
    ground_truth_of_file,
    images_in,
    is_time,
    matched_images,
    own_camera,
    registered_size,
    times_of_names,
)

_FRAMES_PER_SECOND = 30.0


def matches(source: Path) -> bool:
    """True if the folder has rgb/ and depth/."""
    return (source / "rgb").is_dir() and (source / "depth").is_dir()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a plain folder. Arguments and errors as of `open_recording`."""
    colour = images_in(source / "rgb", COLOUR_SUFFIXES)
    depth = images_in(source / "depth", DEPTH_SUFFIXES)
    for name, images in (("rgb", colour), ("depth", depth)):
        if not images:
            raise InputError(f"No images in {source / name}; put the {name} images there as PNG files.")
    intrinsics = own_camera(source, options.camera)
    scale = options.depth_scale or intrinsics.depth_scale
    matched, match_notes = matched_images(source, colour, depth)
    timestamps = times_of_names([pair[0] for pair in matched], intrinsics.fps or _FRAMES_PER_SECOND)
    depth_times = _depth_timestamps(matched)
    pairs = [
        FilePair(colour_path, depth_path, time, depth_time)
        for (colour_path, depth_path), time, depth_time in zip(
            matched, timestamps.tolist(), depth_times, strict=True
        )
    ]
    width, height, depth_notes = registered_size(source, pairs, scale)
    ground_truth, truth_notes = ground_truth_of_file(
        source / "poses.txt", timestamps, options.association_limit
    )
    camera = intrinsics.camera(width, height, source)
    return FileRecording(
        name=source.resolve().name,
        dataset="folder",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *match_notes, *depth_notes, *truth_notes),
        register=intrinsics.undistortion(camera),
    )


def _depth_timestamps(matched: list[tuple[Path, Path]]) -> list[float] | list[None]:
    """Seconds, if all names are decimal numbers. A depth image named after its colour image tells nothing."""
    timed = all(is_time(path) for pair in matched for path in pair)
    if not timed or all(colour.stem == depth.stem for colour, depth in matched):
        return [None] * len(matched)
    return [float(depth.stem) for _, depth in matched]
