"""Keypoint extraction and matching: time and memory beside XFeat and ORB, on two cores.

    python -m benchmarks.superfeats [--weights PATH]

The image is RedKitchen's first at 640x480, found through SFGS_DATA or at ../shared. The contenders take
turns, so that other work on the machine hits all alike; times are medians.

XFeat runs in onnxruntime with two threads. Its file is re-shaped to 640x480 with the same weights and the
cutting into cells as one operation (experiments/xfeat_size.py). Around it runs the extraction in NumPy and
OpenCV of experiments/xfeat.py. Memory is the peak of a process that extracts ten times, minus its need after
the imports. Needs onnxruntime and onnx.
"""

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Table

from experiments.xfeat import MIN_SIMILARITY, XFeat, default_weights, normalised
from experiments.xfeat_size import resized_xfeat
from sfgs_jax import superfeats
from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import Features, filter_by_motion, match
from sfgs_jax.superfeats.network import forward, normalise

TURNS = 5
WARM_SECONDS = 0.25
CALLS = 12
KEYPOINTS = 1024
CORES = 2
EXTRACTORS = ("superfeats", "xfeat", "orb")

Call = Callable[[], object]


def two_images() -> tuple[np.ndarray, np.ndarray]:
    """Two RGB images in [0, 1], ten frames apart."""
    root = Path(os.environ.get("SFGS_DATA", Path(__file__).parents[2] / "shared"))
    folder = root / "data" / "7scenes" / "redkitchen"
    images = [cv2.imread(str(folder / f"frame-{i:06d}.color.jpg")) for i in (0, 10)]
    if any(image is None for image in images):
        raise InputError(f"No RedKitchen at {folder}; set SFGS_DATA to the folder that holds data/.")
    first, second = (np.asarray(image)[..., ::-1].astype(np.float32) / 255 for image in images)
    return first, second


def extraction(name: str, image: np.ndarray, weights: Path | None) -> Callable[[], Features]:
    """A whole extraction of an image on the host, as a function.

    Args:
        name: one of `EXTRACTORS`.
        image: (H, W, 3) RGB in [0, 1].
        weights: file with SuperFeats' weights; None means the shipped ones.
    """
    if name == "superfeats":
        params = superfeats.load_weights(weights)
        return lambda: superfeats.extract(params, image, max_keypoints=KEYPOINTS)
    if name == "xfeat":
        height, width = image.shape[:2]
        network = XFeat(resized_xfeat(default_weights(), height, width), threads=CORES)
        return lambda: network.extract(image, max_keypoints=KEYPOINTS)
    return lambda: superfeats.extract_orb(image, max_keypoints=KEYPOINTS)


def networks(image: np.ndarray, weights: Path | None) -> dict[str, Call]:
    """The networks alone, each on its normalised input."""
    params = superfeats.load_weights(weights)
    grey = image.mean(axis=2)
    height, width = grey.shape
    own = jax.jit(forward)
    own_input = jax.block_until_ready(normalise(jnp.asarray(grey)[None]))
    reshaped, original = (
        XFeat(resized_xfeat(default_weights(), height, width), threads=CORES),
        XFeat(threads=CORES),
    )
    peer_input, square = normalised(grey), np.resize(normalised(grey), original.shape)
    return {
        "superfeats": lambda: own(params, own_input),
        "xfeat": lambda: reshaped.dense(peer_input),
        "xfeat, its file at 640x640": lambda: original.dense(square),
    }


def in_turns(calls: dict[str, Call]) -> dict[str, tuple[float, float]]:
    """Seconds of each first call, and median seconds of the calls in later turns.

    A turn is a few calls after a pause. Without it onnxruntime's threads would slow the next contender down,
    because they spin for a while after a call. After a pause the machine is slow at first: not counted.
    """
    first = {name: seconds(call) for name, call in calls.items()}
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(TURNS):
        for name, call in calls.items():
            time.sleep(0.1)
            warm = time.perf_counter() + WARM_SECONDS
            while time.perf_counter() < warm:
                seconds(call)
            times[name] += [seconds(call) for _ in range(CALLS)]
    return {name: (first[name], float(np.median(times[name]))) for name in calls}


def seconds(call: Call) -> float:
    begin = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - begin


def matchers(a: Features, b: Features) -> dict[str, Call]:
    """Matchers of two images' keypoints: ours, one by argmax, and OpenCV's brute force."""
    matches = match(a, b, min_similarity=MIN_SIMILARITY)

    @jax.jit
    def by_argmax(a: Features, b: Features):
        table = a.descriptors @ b.descriptors.T
        index_b, index_a = table.argmax(axis=1), table.argmax(axis=0)
        return index_b, index_a[index_b] == jnp.arange(len(index_b))

    left, right = np.asarray(a.descriptors), np.asarray(b.descriptors)
    brute_force = cv2.BFMatcher(cv2.NORM_L2, crossCheck=True)
    return {
        "match": lambda: match(a, b, min_similarity=MIN_SIMILARITY),
        "filter_by_motion": lambda: filter_by_motion(a, b, matches),
        "argmax of both directions": lambda: by_argmax(a, b),
        "OpenCV brute force": lambda: len(brute_force.match(left, right)),
    }


def peak_megabytes() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def memory(name: str, weights: Path | None) -> float:
    """Peak memory of a process that extracts with `name`, minus its need after the imports, megabytes."""
    command = [sys.executable, "-m", "benchmarks.superfeats", "--memory-of", name]
    command += ["--weights", str(weights)] if weights else []
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def measure_own_memory(name: str, weights: Path | None) -> None:
    image = two_images()[0]
    jax.block_until_ready(jnp.zeros(1))
    before = peak_megabytes()
    extract = extraction(name, image, weights)
    for _ in range(10):
        jax.block_until_ready(extract())
    print(peak_megabytes() - before)


def show(title: str, calls: dict[str, Call], peer: str, peaks: dict[str, float] | None = None) -> None:
    """Print a table of times, and the ratio of the peer's time to each contender's."""
    table = Table(title=title)
    for column in ("", "ms", f"{peer} / this", "first call s", *(("peak MB",) if peaks else ())):
        table.add_column(column, justify="left" if not column else "right")
    times = in_turns(calls)
    for name, (first, median) in times.items():
        cells = [f"{1000 * median:.2f}", f"{times[peer][1] / median:.2f}", f"{first:.2f}"]
        table.add_row(name, *cells, *([f"{peaks[name]:.0f}"] if peaks else []))
    Console(width=110).print(table)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--weights", type=Path, help="of SuperFeats, by default the shipped ones")
    parser.add_argument("--memory-of", choices=EXTRACTORS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    # Before XLA starts its threads, one for each core it may use.
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:CORES])
    if arguments.memory_of:
        measure_own_memory(arguments.memory_of, arguments.weights)
        return
    image, other = two_images()
    peaks = {name: memory(name, arguments.weights) for name in EXTRACTORS}
    extractions = {name: extraction(name, image, arguments.weights) for name in EXTRACTORS}
    size = f"{image.shape[1]}x{image.shape[0]}"
    show(f"Whole extraction, {size}, {KEYPOINTS} keypoints", {**extractions}, "xfeat", peaks)
    show(f"Network alone, {size}", networks(image, arguments.weights), "xfeat")
    features = [extraction("xfeat", each, None)() for each in (image, other)]
    calls = matchers(features[0], features[1])
    show(f"Matching {KEYPOINTS} XFeat keypoints, 64-D", calls, "argmax of both directions")


if __name__ == "__main__":
    main()
