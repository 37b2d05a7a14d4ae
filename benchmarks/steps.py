"""Times of one call of each compiled step: track, adjust, map_step.

    python -m benchmarks.steps [--recording redkitchen] [--frames 60] [--calls 30]

The recording is followed for some frames first, so that tracker, window and map are those of a run. Each step
is then called repeatedly on the same input, in turns with a yardstick, a product of 1024 x 1024 matrices. The
ratio of the medians can be compared across machines. Recordings are found through SFGS_DATA, by default
`../shared`.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import se3
from sfgs_jax.slam import MapParams, SlamConfig, SlamState, adjust, init, map_step, step, track, window_of
from sfgs_jax.superfeats import mean_grey

MATRIX = 1024


def seconds(call: Callable[[], Any]) -> float:
    """Wall-clock time of one call, seconds."""
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def steps_of(state: SlamState, grey: np.ndarray, depth: np.ndarray) -> dict[str, Callable[[], Any]]:
    """One call of each step on the state of a run."""
    config, view = state.config.mapping, state.mapping.views[-1]
    window = window_of(state.params, state.graph, state.config.graph)
    params = MapParams(
        camera=state.mapping_camera,
        timing=None,
        mean_gain=jnp.ones(3),
        rate=jnp.ones(()),
        config=config.optimisation,
        seeding=config.seeding,
        pair_capacity=state.mapping.pair_capacity,
        view_capacity=state.mapping.view_capacity,
    )
    pose = se3.compose(state.graph.pose(view.keyframe), view.T_keyframe_cam)
    elapsed = np.float32(1 / 30)
    return {
        "track": lambda: track(state.params, state.tracker, grey, depth, elapsed),
        "adjust": lambda: adjust(state.params, window),
        "map_step": lambda: map_step(params, state.mapping.map, view, pose),
    }


def main() -> None:
    """Print a table of medians and ratios."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--recording", default="redkitchen", help="a name of experiments.recordings, or a source"
    )
    parser.add_argument("--frames", type=int, default=60, help="frames followed before")
    parser.add_argument("--calls", type=int, default=30, help="timed calls of each step")
    options = parser.parse_args()
    recording = open_recording(SOURCES.get(options.recording) or options.recording)
    state = init(recording.camera, SlamConfig())
    for i in range(options.frames):
        state, _ = step(state, recording[i])
    frame = recording[options.frames]
    calls = steps_of(state, np.asarray(mean_grey(frame.rgb)), np.asarray(frame.depth))
    matrix = jnp.ones((MATRIX, MATRIX))
    product = jax.jit(lambda a: a @ a)
    print("| step | median ms | over a 1024 x 1024 product |")
    print("| --- | --- | --- |")
    for name, call in calls.items():
        seconds(call)
        seconds(lambda: product(matrix))
        pairs = [(seconds(call), seconds(lambda: product(matrix))) for _ in range(options.calls)]
        one, other = np.median(np.asarray(pairs), axis=0)
        print(f"| {name} | {1e3 * one:.1f} | {one / other:.2f} |")


if __name__ == "__main__":
    main()
