"""ICL-NUIM rooms, the TUM-compatible PNG export: rgb/N.png, depth/N.png, associations.txt, *.gt.freiburg.

Source: Handa et al., A Benchmark for RGB-D Visual Odometry, 3D Reconstruction and SLAM, ICRA 2014.

The set's calibration has fy = -480: its camera and world have y pointing up, which makes both left-handed.
The images are stored top row first as any others, so with y turned down the camera is an ordinary one with
fy = +480. The same reflection S = diag(1, -1, 1) of camera and world turns a published pose (R, t) into
(S R S, S t), which is a proper rigid motion. World coordinates are thus the published ones with
y negated.
"""

from pathlib import Path

import numpy as np

from sfgs_jax.datasets.file_recording import FilePair, FileRecording, registered_size
from sfgs_jax.datasets.files import by_number
from sfgs_jax.datasets.ground_truth import ground_truth_of, not_finite_note
from sfgs_jax.datasets.intrinsics import Intrinsics, read_camera_json
from sfgs_jax.datasets.options import ReaderOptions
from sfgs_jax.datasets.pose_files import read_text, read_tum_poses
from sfgs_jax.geometry import InputError

_FRAMES_PER_SECOND = 30.0
_UNITS_PER_METRE = 5000.0
_CAMERA = Intrinsics(481.2, 480.0, 319.5, 239.5, width=640, height=480)
_REFLECTION = np.diag([1.0, -1.0, 1.0, 1.0])


def matches(source: Path) -> bool:
    """Whether the folder is an ICL-NUIM export: images by number, and a pose file *.gt.freiburg."""
    return (source / "rgb").is_dir() and any(source.glob("*.gt.freiburg"))


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open an ICL-NUIM sequence. Raises InputError as `open_recording` says."""
    intrinsics = read_camera_json(options.camera) if options.camera else _CAMERA
    scale = options.depth_scale or _UNITS_PER_METRE
    frames = _frames(source)
    pairs = [FilePair(colour, depth, n / _FRAMES_PER_SECOND) for n, (colour, depth) in sorted(frames.items())]
    width, height, depth_notes = registered_size(source, pairs, scale)
    truth, truth_notes = {}, []
    for path in sorted(source.glob("*.gt.freiburg"))[:1]:
        trajectory, broken = read_tum_poses(path)
        truth_notes = not_finite_note(broken)
        numbers = (
            np.round(trajectory.timestamps).astype(int).tolist()
        )  # the first column is the frame's number
        truth = dict(zip(numbers, _REFLECTION @ trajectory.poses @ _REFLECTION, strict=True))
    timestamps = np.asarray([pair.timestamp for pair in pairs])
    ground_truth, missing_notes = ground_truth_of([truth.get(n) for n in sorted(frames)], timestamps)
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
    """Colour and depth image of each frame number."""
    associations = source / "associations.txt"
    if not associations.is_file():
        colour, depth = by_number(source / "rgb", "", (".png",)), by_number(source / "depth", "", (".png",))
        return {n: (colour[n], depth[n]) for n in colour.keys() & depth.keys()}
    frames = {}
    for number, line in enumerate(read_text(associations).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            # The published files put depth first; ones that users write often put colour first.
            first, second = (source / words[1], source / words[3])
            colour, depth = (second, first) if first.parent.name == "depth" else (first, second)
            frames[int(colour.stem)] = (colour, depth)
        except (IndexError, ValueError):
            raise InputError(
                f"{associations}, line {number}: expected 'N depth/N.png N rgb/N.png', found {line!r}."
            ) from None
    return frames
