"""Time that tracking and mapping lose to a live view with a browser.

    python -m benchmarks.live_view [--recording SOURCE] [--frames 200] [--block 40]

Blocks of frames are done twice from the same state, once watched and once not, in alternating order. The work
is the same, so the ratio of the times is the view's. The browser runs on the same machine, headless and with
WebGL in software. It is open all the time, so only its work on updates counts. The CPU time is that of this
process without the browser, which has a GPU elsewhere.
"""

import argparse
import time

import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax import slam
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import Frame
from sfgs_jax.viewer import LiveView
from tests.viewer.browser import OpenPage, find_chromium, headless


def follow(
    state: slam.SlamState, frames: list[Frame], view: LiveView | None
) -> tuple[slam.SlamState, np.ndarray]:
    """The state after a block of frames, and the seconds that it took: by the clock, and of processors."""
    run = slam.Run(state)
    start = np.asarray([time.perf_counter(), time.process_time()])
    for frame in frames:
        with run.stopwatch("frame"):
            run.state, info = slam.step(run.state, frame)
        run.num_frames = run.state.next_frame
        if view is not None:
            view(slam.Progress("frames", run.num_frames, 0, None, info, run, frame))
    return run.state, np.asarray([time.perf_counter(), time.process_time()]) - start


def main() -> None:
    """Print a row for each block, and the median ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recording", default="synthetic:frames=240,width=320,height=240")
    parser.add_argument("--frames", type=int, default=200, help="frames to follow, after the first block")
    parser.add_argument("--block", type=int, default=40, help="frames in a block")
    options = parser.parse_args()
    recording = open_recording(SOURCES.get(options.recording) or options.recording)
    program = find_chromium()
    if program is None:
        raise SystemExit("no browser is installed")
    slam.warm_up(recording.camera)
    state, ratios = slam.init(recording.camera), []
    with LiveView(ground_truth=recording.ground_truth) as view, headless(program) as browser:
        page = OpenPage(browser, view.server.get_port())
        blocks = range(0, min(options.frames + options.block, len(recording)), options.block)
        print("| frames | unwatched, s | watched, s | ratio | unwatched, CPU s | watched, CPU s | ratio |")
        print("| --- | --- | --- | --- | --- | --- | --- |")
        for number, first in enumerate(blocks):
            frames = [recording[i] for i in range(first, min(first + options.block, len(recording)))]
            order = (None, view) if number % 2 else (view, None)
            done = {watched: follow(state, frames, watched) for watched in order}
            (state, alone), (_, watched) = done[None], done[view]
            if number:  # the first block compiles
                ratios.append(watched / alone)
                rows = np.stack([alone, watched, watched / alone], axis=1).ravel()
                numbers = " | ".join(f"{number:.2f}" for number in rows)
                print(f"| {first} to {first + len(frames) - 1} | {numbers} |", flush=True)
        assert not page.errors, page.errors
    wall, cpu = np.median(ratios, axis=0)
    print(f"median ratio {wall:.3f} by the clock, {cpu:.3f} of the process's CPU time")


if __name__ == "__main__":
    main()
