"""ICL-NUIM rooms, the TUM-compatible PNG export: rgb/N.png, depth/N.png, associations.txt, *.gt.freiburg.

Source: Handa et al., A Benchmark for RGB-D Visual Odometry, 3D Reconstruction and SLAM, ICRA 2014.

The set's calibration has fy = -480: its camera and world have y pointing up, which makes both left-handed.
The images are stored top row first as usual, so with y turned down the camera is an ordinary one with
fy = +480. The reflection S = diag(1, -1, 1) of camera and world turns a published pose (R, t) into
(S R S, S t), which is a proper rigid motion. World coordinates are the published ones with y negated.
"""

from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    FilePair,
    FileRecording,
    Intrinsics,
    ground_truth_by_frame,
    images_by_number,
    listed_file,
    not_finite_notes,
    read_camera_json,
    read_text,
    read_tum_poses,
    registered_size,
)

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 5000.0
_CAMERA = Intrinsics(481.2, 480.0, 319.5, 239.5, width=640, height=480)
_REFLECTION = np.diag([1.0, -1.0, 1.0, 1.0])


def matches(source: Path) -> bool:
    """True if the folder has rgb/ and a pose file *.gt.freiburg."""
    return (source / "rgb").is_dir() and any(source.glob("*.gt.freiburg"))


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open an ICL-NUIM sequence. Arguments and errors as of `open_recording`."""
    intrinsics = read_camera_json(options.camera) if options.camera else _CAMERA
    scale = options.depth_scale or _UNITS_PER_METRE
    frames = _frames(source)
    pairs = [FilePair(colour, depth, n / _FRAMES_PER_SECOND) for n, (colour, depth) in sorted(frames.items())]
    width, height, depth_notes = registered_size(source, pairs, scale)
    truth, truth_notes = {}, []
    for path in sorted(source.glob("*.gt.freiburg"))[:1]:
        trajectory, broken = read_tum_poses(path)
        truth_notes = not_finite_notes(broken)
        # The first column is the frame's number.
        numbers = np.round(trajectory.timestamps).astype(int).tolist()
        truth = dict(zip(numbers, _REFLECTION @ trajectory.poses @ _REFLECTION, strict=True))
    timestamps = np.asarray([pair.timestamp for pair in pairs])
    ground_truth, missing_notes = ground_truth_by_frame([truth.get(n) for n in sorted(frames)], timestamps)
    camera = intrinsics.camera(width, height, source)
    return FileRecording(
        name=source.resolve().name,
        dataset="icl_nuim",
        camera=camera,
        pairs=pairs,
        units_per_metre=scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *depth_notes, *truth_notes, *missing_notes),
        register=intrinsics.undistortion(camera),
    )


def _frames(source: Path) -> dict[int, tuple[Path, Path]]:
    """Colour and depth image by frame number."""
    associations = source / "associations.txt"
    if not associations.is_file():
        colour, depth = (images_by_number(source / kind, "", (".png",)) for kind in ("rgb", "depth"))
        return {n: (colour[n], depth[n]) for n in colour.keys() & depth.keys()}
    frames = {}
    for number, line in enumerate(read_text(associations).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            # The published files put depth first; files that users write often put colour first.
            first, second = (listed_file(source, words[i], associations) for i in (1, 3))
            colour, depth = (second, first) if first.parent.name == "depth" else (first, second)
            frames[int(colour.stem)] = (colour, depth)
        except (IndexError, ValueError):
            raise InputError(
                f"{associations}, line {number}: expected 'N depth/N.png N rgb/N.png', found {excerpt(line)}."
            ) from None
    return frames
