"""Gradients through tracking: time to compile and run them, and the memory of sequences.

    python -m benchmarks.gradients [--width 160] [--lengths 8 30]

The last pose of a sequence, and its gradient by image, depth, intrinsics and network: processor seconds to
trace and compile, memory that XLA sets aside, and the shortest of five times. A reverse mode that keeps
trackers computes the rest of each frame again.
"""

import argparse
import time
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from experiments.matching_tables import print_table
from sfgs_jax import datasets, slam
from sfgs_jax.geometry import se3

RUNS = 5


class Frames:
    """Frames of the synthetic room as inputs of tracking."""

    def __init__(self, width: int, count: int) -> None:
        recording = datasets.SyntheticRecording(num_frames=120, width=width, height=width * 3 // 4)
        first, *frames = [recording[i] for i in range(count + 1)]
        self.params = slam.tracker_params(recording.camera, slam.TrackingConfig())
        self.weights, self.rest = eqx.partition(self.params, eqx.is_inexact_array)
        # A first frame has no registration that could have a gradient.
        seen = jnp.asarray(first.rgb), jnp.asarray(first.depth), jnp.float32(0)
        self.tracker, _ = slam.track(self.params, slam.init_tracker(self.params), *seen)
        self.images = jnp.stack([jnp.asarray(f.rgb) for f in frames])
        self.depths = jnp.stack([jnp.asarray(f.depth) for f in frames])
        self.elapsed = jnp.full(count, 1 / 30, jnp.float32)

    def last_pose(self, weights: slam.TrackerParams, images: Array, depths: Array, keep: bool) -> Array:
        """A number that the pose of the last frame decides."""
        params = eqx.combine(weights, self.rest)
        frames = images, depths, self.elapsed[: len(images)]
        _, found = slam.track_sequence(params, self.tracker, *frames, rematerialise=not keep)
        return jnp.sum(se3.log(found.T_world_cam)[-1])


def compiled(function: Callable, *inputs: object) -> tuple[jax.stages.Compiled, float]:
    """A compiled function, and the processor seconds that it took to trace and compile."""
    start = time.process_time()
    done = jax.jit(function).lower(*inputs).compile()
    return done, time.process_time() - start


def temporary(function: jax.stages.Compiled) -> int:
    """Bytes that a compiled function sets aside beside its inputs and results."""
    analysis = function.memory_analysis()
    assert analysis is not None
    return analysis.temp_size_in_bytes


def seconds(function: Callable, *inputs: object) -> float:
    """Shortest of a few times of a call."""
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        jax.block_until_ready(function(*inputs))
        times.append(time.perf_counter() - start)
    return min(times)


def row(frames: Frames, length: int, keep: bool) -> tuple[str, ...]:
    """Compilation, memory and times of the last pose of so many frames and of its gradient."""
    inputs = frames.weights, frames.images[:length], frames.depths[:length]

    def value(weights: slam.TrackerParams, images: Array, depths: Array) -> Array:
        return frames.last_pose(weights, images, depths, keep)

    forward, forward_cpu = compiled(value, *inputs)
    gradient, gradient_cpu = compiled(jax.value_and_grad(value, argnums=(0, 1, 2)), *inputs)
    once, both = seconds(forward, *inputs), seconds(gradient, *inputs)
    memory = [temporary(f) / 1e6 for f in (forward, gradient)]
    return (
        str(length),
        "everything" if keep else "trackers",
        f"{forward_cpu:.0f} / {gradient_cpu:.0f}",
        f"{memory[0]:.1f} / {memory[1]:.1f}",
        f"{1e3 * once:.0f} / {1e3 * both:.0f}",
        f"{both / once:.1f}",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--width", type=int, default=160)
    parser.add_argument("--lengths", type=int, nargs="+", default=[1, 8, 30])
    arguments = parser.parse_args()
    frames = Frames(arguments.width, int(np.max(arguments.lengths)))
    columns = ("frames", "kept", "compile CPU s", "memory MB", "ms", "ratio")
    rows = (row(frames, n, keep) for n in arguments.lengths for keep in (False, True))
    print_table(f"value / gradient of the last pose, {frames.params.camera.shape[::-1]}", columns, rows)


if __name__ == "__main__":
    main()
