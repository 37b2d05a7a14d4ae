"""TUM RGB-D recordings: rgb.txt, depth.txt, and optionally groundtruth.txt.

Source: Sturm et al., A Benchmark for the Evaluation of RGB-D SLAM Systems, IROS 2012, and its file formats.
"""

import math
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._association import associate
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    CAMERA_EXAMPLE,
    FilePair,
    FileRecording,
    Intrinsics,
    ground_truth_by_time,
    listed_file,
    read_camera_json,
    read_text,
    registered_size,
)

_FREIBURG = {
    "freiburg1": Intrinsics(
        517.3, 516.5, 318.6, 255.3, distortion=(0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    "freiburg2": Intrinsics(
        520.9, 521.0, 325.1, 249.7, distortion=(0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "freiburg3": Intrinsics(535.4, 539.2, 320.1, 247.6),
}
# The correction factors that early papers applied to the depth are already in the images.
_UNITS_PER_METRE = 5000.0


def matches(source: Path) -> bool:
    """True if the folder has rgb.txt and depth.txt."""
    return (source / "rgb.txt").is_file() and (source / "depth.txt").is_file()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a TUM recording. Arguments and errors as of `open_recording`."""
    intrinsics = _intrinsics(source, options)
    scale = options.depth_scale or intrinsics.depth_scale or _UNITS_PER_METRE
    colour_times, colour = _read_list(source / "rgb.txt")
    depth_times, depth = _read_list(source / "depth.txt")
    matched = associate(colour_times, depth_times, options.association_limit)
    if len(colour) and len(depth) and not len(matched):
        raise InputError(
            f"No time stamps of {source}/rgb.txt and depth.txt are within {options.association_limit:g} s of "
            "each other; check that both use one clock, or raise the association limit."
        )
    notes = list(intrinsics.notes)
    if len(matched) < len(colour):
        notes.append(
            f"{len(colour) - len(matched)} of {len(colour)} colour images have no depth image within "
            f"{options.association_limit:g} s and are left out."
        )
    pairs = [FilePair(colour[i], depth[j], colour_times[i].item(), depth_times[j].item()) for i, j in matched]
    width, height, depth_notes = registered_size(source, pairs, scale)
    ground_truth, truth_notes = ground_truth_by_time(
        source / "groundtruth.txt", colour_times[matched[:, 0]], options.association_limit
    )
    camera = intrinsics.camera(width, height, source)
    return FileRecording(
        name=source.resolve().name,
        dataset="tum",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*notes, *depth_notes, *truth_notes),
        register=intrinsics.undistortion(camera),
    )


def _intrinsics(source: Path, options: ReaderOptions) -> Intrinsics:
    if options.camera is not None:
        return read_camera_json(options.camera)
    if (source / "camera.json").is_file():
        return read_camera_json(source / "camera.json")
    for name, intrinsics in _FREIBURG.items():
        if name in source.resolve().name.lower():
            return intrinsics
    raise InputError(
        f"Intrinsics of {source} are missing: its name does not say freiburg1, 2 or 3, and there is no "
        f"{source / 'camera.json'}; write one such as {CAMERA_EXAMPLE}."
    )


def _read_list(path: Path) -> tuple[Float[np.ndarray, " n"], list[Path]]:
    """Time stamps, sorted, and files of an `rgb.txt` or `depth.txt`."""
    rows = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split("#")[0].split(maxsplit=1)
        if not words:
            continue
        try:
            time, name = float(words[0]), words[1].strip()
        except (ValueError, IndexError):
            raise InputError(
                f"{path}, line {number}: expected 'timestamp file', found {excerpt(line)}."
            ) from None
        if not math.isfinite(time):
            raise InputError(f"{path}, line {number}: {excerpt(words[0])} is no time stamp in seconds.")
        rows.append((time, listed_file(path.parent, name, path)))
    rows.sort(key=lambda row: row[0])
    return np.asarray([row[0] for row in rows], np.float64), [row[1] for row in rows]
