"""SuperFeats beside XFeat and ORB on the same pairs in one run: relative poses and homographies.

    python -m experiments.feature_matching [--weights PATH] [--extractors NAME ...] [--recording DIR ...]

Without options the pairs come from RedKitchen's frames 300 to 599, fr1_rpy, the ScanNet pairs, and changed
photographs that SuperFeats was not trained on. They are found through SFGS_DATA, by default `../shared`.

Relative poses are found by RANSAC over essential matrices at 1 pixel. A pair's angular error is the larger of
rotation's and the translation direction's. An accuracy is the share of pairs with an error below the angle.
The camera of fr1_rpy turns but hardly moves, so the rotation's error alone counts there. RANSAC runs several
times on each pair, with the matches in another order; ± is the standard deviation.

Poses and intrinsics are the readers'; for 7-Scenes they belong to its colour camera. The tables are in
Markdown; experiments/results.md keeps the last ones. Needs onnxruntime and onnx.
"""

import argparse
import os
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

import jax
import numpy as np

from experiments.extractors import NAMES, Extractor, make_extractor
from experiments.matching_tables import (
    PLANE_COLUMNS,
    POSE_COLUMNS,
    TOTAL,
    PoseSample,
    plane_table,
    pose_table,
    print_table,
)
from experiments.superfeats_pairs import held_out
from experiments.warped_photos import WarpedPhoto, warped_photos
from sfgs_jax.datasets import (
    Photos,
    PosePair,
    ReaderOptions,
    RecordingPair,
    open_recording,
    read_hpatches,
    read_megadepth_1500,
    read_photos,
    read_scannet_1500,
    recording_pairs,
)
from sfgs_jax.superfeats import Features

DATA = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared")) / "data"
REDKITCHEN = str(DATA / "7scenes" / "redkitchen")
FR1_RPY = str(DATA / "tum" / "rgbd_dataset_freiburg1_rpy")
TURNING_GAPS = (10, 15, 20)
TABLES = ("recording", "turning", "pairs", "planes")
PLANE_KEYPOINTS = 1024
MEGADEPTH_PIXELS = 1200
PIXELS = 640


def of_recording(folder: str, options: ReaderOptions, *, turning: bool = False) -> list[PoseSample]:
    """Pairs of a recording: frames 10, 20, 30 and 45 apart, at least 10 cm and at most 45 degrees.

    Args:
        folder: the recording.
        options: of its reader.
        turning: the camera turns but hardly moves. Frames are then `TURNING_GAPS` apart, at any distance.
    """
    recording = open_recording(folder, options=options)
    K = np.asarray(recording.camera.matrix(), np.float64)

    @cache
    def of_frame(extractor: Extractor, index: int) -> Features:
        return jax.device_get(extractor.extract(np.asarray(recording[index].rgb)))

    def sample(pair: RecordingPair) -> PoseSample:
        def features(extractor: Extractor) -> tuple[Features, Features]:
            return of_frame(extractor, pair.index_a), of_frame(extractor, pair.index_b)

        return PoseSample(f"{pair.gap} frames", features, K, K, pair.T_b_a, turning)

    pairs = (
        recording_pairs(recording, gaps=TURNING_GAPS, min_distance=0.0)
        if turning
        else recording_pairs(recording)
    )
    return [sample(pair) for pair in pairs]


def of_photographs(pairs: Iterable[PosePair], longest: int) -> Iterator[PoseSample]:
    """Pairs of photographs, their longer sides shrunk to `longest` pixels."""
    for pair in pairs:
        (a, b), (K_a, K_b) = pair.load(longest=longest)
        # The caller uses each sample before the next pair is loaded.
        yield PoseSample(TOTAL, lambda x, a=a, b=b: (x.extract(a), x.extract(b)), K_a, K_b, pair.T_b_a)


def of_hpatches(folder: str) -> Iterator[WarpedPhoto]:
    """HPatches at the size of a video frame."""
    for pair in read_hpatches(folder):
        (a, b), H_b_a = pair.load(longest=PIXELS)
        yield WarpedPhoto(pair.group, a, b, H_b_a)


def unseen_photos() -> Photos:
    """The photographs that `train_superfeats` leaves out."""
    return Photos(tuple(held_out(sorted(read_photos(DATA / "photos").paths))))


def main() -> None:
    """Print the requested tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--extractors", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--weights", type=Path, help="of SuperFeats, by default the shipped ones")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES)
    parser.add_argument("--keypoints", type=int, default=2048, help="per image, for relative poses")
    parser.add_argument("--seeds", type=int, default=5, help="RANSAC's runs on each pair")
    parser.add_argument("--recording", nargs="+", metavar="DIR", help="instead of RedKitchen 300 to 599")
    parser.add_argument("--scannet", metavar="DIR", default=str(DATA / "scannet_pairs"))
    parser.add_argument("--megadepth", metavar="DIR", help="MegaDepth-1500")
    parser.add_argument("--photos", metavar="DIR", help="instead of those that no training saw")
    parser.add_argument("--num-photos", type=int, default=60)
    parser.add_argument("--hpatches", metavar="DIR")
    arguments = parser.parse_args()

    def extractors(max_keypoints: int) -> list[Extractor]:
        return [
            make_extractor(name, max_keypoints=max_keypoints, weights=arguments.weights)
            for name in arguments.extractors
        ]

    def poses(title: str, samples: Iterable[PoseSample]) -> None:
        rows = pose_table(samples, extractors(arguments.keypoints), seeds=arguments.seeds)
        print_table(f"Relative pose, {title}, {arguments.keypoints} keypoints", POSE_COLUMNS, rows)

    def planes(title: str, pairs: Iterable[WarpedPhoto]) -> None:
        rows = plane_table(pairs, extractors(PLANE_KEYPOINTS))
        print_table(f"Homography, {title}, {PLANE_KEYPOINTS} keypoints", PLANE_COLUMNS, rows)

    if "recording" in arguments.tables:
        if arguments.recording:
            for folder in arguments.recording:
                poses(Path(folder).name, of_recording(folder, ReaderOptions()))
        else:
            poses("RedKitchen 300 to 599", of_recording(REDKITCHEN, ReaderOptions(start=300, end=600)))
    if "turning" in arguments.tables:
        poses("fr1_rpy, rotation alone", of_recording(FR1_RPY, ReaderOptions(), turning=True))
    if "pairs" in arguments.tables:
        poses(f"ScanNet at {PIXELS} pixels", of_photographs(read_scannet_1500(arguments.scannet), PIXELS))
        if arguments.megadepth:
            pairs = read_megadepth_1500(arguments.megadepth)
            poses(f"MegaDepth at {MEGADEPTH_PIXELS} pixels", of_photographs(pairs, MEGADEPTH_PIXELS))
    if "planes" in arguments.tables:
        photos = read_photos(arguments.photos) if arguments.photos else unseen_photos()
        planes("changed photographs", warped_photos(photos, count=arguments.num_photos, seed=0))
        if arguments.hpatches:
            planes("HPatches", of_hpatches(arguments.hpatches))


if __name__ == "__main__":
    main()
