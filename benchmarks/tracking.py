"""Times from a decoded frame to its pose, on real recordings.

    python -m benchmarks.tracking [--recordings redkitchen fr1_rpy]

The tracking stage, and whole frames with the graph of keyframes; no map, and without the first frame, which
compiles everything. *Decoded before*: fifty frames at a time are decoded first, as a camera would hand them
over; *fastest of 3* takes from three such runs each frame's shortest time, which is what the work takes when
nothing else wants the machine. *While decoding*: a thread reads and decodes the next frames' files meanwhile,
on the same cores. Recordings are found through SFGS_DATA, by default `../shared`.

Machines differ, and a shared one from minute to minute, so every 25 frames XFeat extracts keypoints of one,
in onnxruntime with two threads: tracking's median over XFeat's can be compared. Needs onnxruntime and onnx.
"""

import argparse
import time
from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.superfeats import extraction
from experiments.recordings import SOURCES
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording, open_recording, prefetch
from sfgs_jax.geometry import Frame
from sfgs_jax.slam import SlamConfig, Stopwatch, follow, init

AT_ONCE = 50
RUNS = 3
BESIDE = 25


def decoded_before(recording: Recording) -> Iterator[Frame]:
    """The frames, so many decoded at once."""
    for first in range(0, len(recording), AT_ONCE):
        yield from [recording[i] for i in range(first, min(first + AT_ONCE, len(recording)))]


def while_decoding(recording: Recording) -> Iterator[Frame]:
    """The frames, decoded in a thread."""
    for _, frame in prefetch(recording):
        if isinstance(frame, FrameError):
            raise frame
        yield frame


def times(recording: Recording, frames: Iterator[Frame]) -> np.ndarray:
    """(3, frames - 1) milliseconds of tracking, of whole frames, and of XFeat on its last frame."""
    state, stopwatch, rows = init(recording.camera, SlamConfig()), Stopwatch(), []
    xfeat = 0.0
    for frame in frames:
        if len(rows) % BESIDE == 0:
            xfeat = time_of(extraction("xfeat", np.asarray(frame.rgb), None))
        start, before = time.perf_counter(), stopwatch.total("tracking")
        state, _, _ = follow(state, frame, stages=stopwatch)
        rows.append((stopwatch.total("tracking") - before, time.perf_counter() - start, xfeat))
    return 1e3 * np.asarray(rows[1:]).T


def time_of(call: Callable[[], object]) -> float:
    """Seconds of the faster of two calls, after one that has everything else in it."""
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return min(seconds[1:])


def print_row(name: str, how: str, milliseconds: np.ndarray) -> None:
    """Median and 95th percentile of both, how many whole frames a second, and tracking beside XFeat."""
    tracking, whole, xfeat = milliseconds
    columns = [f"{np.median(row):.1f} / {np.percentile(row, 95):.1f}" for row in (tracking, whole)]
    columns += [f"{1e3 / whole.mean():.1f}", f"{np.median(xfeat):.0f}"]
    columns += [f"{np.median(tracking) / np.median(xfeat):.2f}"]
    print("| " + " | ".join([name, how, *columns]) + " |", flush=True)


def main() -> None:
    """Measure the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy"], choices=SOURCES)
    print(
        "| recording | frames | tracking ms median / p95 | with the graph ms | frames/s | XFeat ms | ratio |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for name in parser.parse_args().recordings:
        recording = open_recording(SOURCES[name])
        runs = [times(recording, decoded_before(recording)) for _ in range(RUNS)]
        for run in runs:
            print_row(name, "decoded before", run)
        print_row(name, f"fastest of {RUNS}", np.minimum.reduce(runs))
        print_row(name, "while decoding", times(recording, while_decoding(recording)))


if __name__ == "__main__":
    main()
