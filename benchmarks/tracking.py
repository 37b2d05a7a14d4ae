"""Times from a decoded frame to its pose, on real recordings.

    python -m benchmarks.tracking [--recordings redkitchen fr1_rpy]

The tracking stage alone, and whole frames with the graph of keyframes; no map, and without the first frame,
which compiles everything. *Decoded before*: fifty frames at a time are decoded first, as a camera would hand
them over. *While decoding*: a thread reads and decodes the next frames' files meanwhile, on the same cores.
Recordings are found through SFGS_DATA, by default `../shared`.
"""

import argparse
import time
from collections.abc import Iterator

import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax.datasets import Recording, open_recording, prefetch
from sfgs_jax.geometry import Frame, FrameError
from sfgs_jax.slam import SlamConfig, init
from sfgs_jax.slam.step import follow
from sfgs_jax.slam.stopwatch import Stopwatch

AT_ONCE = 50


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


def measure(recording: Recording, frames: Iterator[Frame]) -> list[str]:
    """Columns of a row: times of tracking and of whole frames."""
    state, stopwatch, whole = init(recording.camera, SlamConfig()), Stopwatch(), []
    for frame in frames:
        start = time.perf_counter()
        state, _, _ = follow(state, frame, stages=stopwatch)
        whole.append(1e3 * (time.perf_counter() - start))
    tracking = stopwatch.summary()["tracking"]
    warm = np.asarray(whole[1:])
    return [
        f"{tracking['median_ms']:.1f} / {tracking['p95_ms']:.1f}",
        f"{np.median(warm):.1f} / {np.percentile(warm, 95):.1f}",
        f"{1e3 / np.mean(warm):.1f}",
    ]


def main() -> None:
    """Measure the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="*", default=["redkitchen", "fr1_rpy"], choices=SOURCES)
    print("| recording | frames | tracking ms median / p95 | with the graph ms | frames/s |")
    print("| --- | --- | --- | --- | --- |")
    for name in parser.parse_args().recordings:
        recording = open_recording(SOURCES[name])
        for how in (decoded_before, while_decoding):
            row = [name, how.__name__.replace("_", " "), *measure(recording, how(recording))]
            print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
