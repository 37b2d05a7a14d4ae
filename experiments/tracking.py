"""The paper's ablations and sparse frames: error and speed of tracking alone, without a map.

    python -m experiments.tracking [--recordings redkitchen fr1_rpy] [--tables variants strides faint]

Real recordings are found through SFGS_DATA, by default `../shared`. Every row is a run of its own over the
whole recording. ATE is the RMSE over all tracked frames after SE(3) alignment, by where the graph has their
keyframes at the end. Times are of the stage from a decoded frame to its pose, without the first frame. In
the faint table the frames are few, and their images have next to no texture: blurred and without contrast,
or left out (GICP alone).
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
from rich.progress import track

from experiments.recordings import SOURCES
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import ReaderOptions, Recording, open_recording, prefetch
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Frame
from sfgs_jax.slam import SlamConfig, Stopwatch, finish, follow, init

TRACKING, GRAPH = (
    replace(SlamConfig().tracking, estimate_timing=True, estimate_depth=True, estimate_extrinsic=True),
    SlamConfig().graph,
)
WHOLE = replace(SlamConfig(), tracking=TRACKING)


def with_features(kind: str) -> SlamConfig:
    """The system with other keypoints."""
    return replace(WHOLE, tracking=replace(TRACKING, features=replace(TRACKING.features, kind=kind)))


BLIND = replace(TRACKING.features, guidance=0.0)
AS_DETECTED = replace(TRACKING.features, align_patches=False)
VARIANTS = {
    "whole system": WHOLE,
    "ORB for SuperFeats": with_features("orb"),
    "GICP alone": with_features("none"),
    "keypoints alone": replace(WHOLE, tracking=replace(TRACKING, use_surface=False)),
    "without guided matching": replace(WHOLE, tracking=replace(TRACKING, features=BLIND)),
    "matches as detected": replace(WHOLE, tracking=replace(TRACKING, features=AS_DETECTED)),
    "without landmarks": replace(WHOLE, graph=replace(GRAPH, window=0)),
    "without loops": replace(WHOLE, graph=replace(GRAPH, loops=False)),
    "without the factor graph": replace(WHOLE, graph=replace(GRAPH, enabled=False)),
    "without the sensors' model": SlamConfig(),
}
STRIDES = (1, 2, 3, 5)
FAINT_STRIDES = (5, 10, 20)
FAINT_CONTRAST, FAINT_BLUR = 0.15, 2.0


def faint(frame: Frame) -> Frame:
    """The frame with its image blurred, by 2 pixels, and of a seventh of its contrast."""
    blurred = cv2.GaussianBlur(np.asarray(frame.rgb, np.float32), (0, 0), FAINT_BLUR)
    return replace(frame, rgb=blurred.mean() + FAINT_CONTRAST * (blurred - blurred.mean()))


def measure(
    recording: Recording,
    config: SlamConfig,
    name: str,
    change: Callable[[Frame], Frame] = lambda frame: frame,
) -> tuple[str, ...]:
    """Track a recording, its frames changed, and give its row of a table."""
    state, stopwatch = init(recording.camera, config), Stopwatch()
    for _, frame in track(prefetch(recording), description=name, total=len(recording), transient=True):
        if not isinstance(frame, FrameError):
            state, _, _ = follow(state, change(frame), stages=stopwatch)
    state, truth = finish(state), recording.ground_truth
    enough = len(state.trajectory) > 2
    error = 100 * ate(state.trajectory, truth).rmse_m if truth is not None and enough else np.nan
    times = stopwatch.summary()["tracking"]
    return (
        name,
        f"{len(state.trajectory)} / {len(recording)}",
        f"{error:.2f}",
        str(len(state.graph.keyframes)),
        str(len(state.graph.loops)),
        f"{times['median_ms']:.0f} / {times['p95_ms']:.0f}",
    )


def main() -> None:
    """Print the tables asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="+", default=["redkitchen", "fr1_rpy"], choices=list(SOURCES))
    tables = ["variants", "strides", "faint"]
    parser.add_argument("--tables", nargs="+", default=tables, choices=tables)
    arguments = parser.parse_args()
    header = ("", "tracked", "ATE cm", "keyframes", "loops", "tracking ms median / p95")
    for source in arguments.recordings:
        rows = []
        if "variants" in arguments.tables:
            recording = open_recording(SOURCES[source])
            rows += [measure(recording, config, name) for name, config in VARIANTS.items()]
        if "strides" in arguments.tables:
            for stride in STRIDES:
                recording = open_recording(SOURCES[source], options=ReaderOptions(stride=stride))
                rows.append(measure(recording, WHOLE, f"every {stride}. frame"))
        if "faint" in arguments.tables:
            for stride in FAINT_STRIDES:
                recording = open_recording(SOURCES[source], options=ReaderOptions(stride=stride))
                rows.append(measure(recording, WHOLE, f"every {stride}. frame, faint", faint))
                rows.append(measure(recording, VARIANTS["GICP alone"], f"every {stride}. frame, GICP alone"))
        print(f"\n{source}\n")
        for row in (header, tuple("---" for _ in header), *rows):
            print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
