"""A map after ten thousand steps: is every Gaussian finite, and is anything compiled on the way?

    python -m experiments.long_refinement [--recordings room redkitchen ...] [--steps 10000] [--max-width 160]

A recording is tracked and mapped, and then its map is refined far longer than anybody does. Each row is of
the steps since the one before, the first row without its first thirty.
"""

import argparse
import sys
import time
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax.datasets import ReaderOptions, open_recording
from sfgs_jax.slam import PRESETS, Progress, run
from sfgs_jax.splatting import Gaussians

RECORDINGS = {
    "room": "synthetic:frames=240,noise=1",
    **{name: SOURCES[name] for name in ("redkitchen", "fr1_rpy")},
}
_FIRST = 30
"""Steps after which nothing may be compiled."""
_COMPILED = "/jax/core/compile/backend_compile_duration"
"""Event of JAX's monitoring for each program that is compiled."""


def not_finite(gaussians: Gaussians) -> int:
    """Gaussians with a parameter that is not finite.

    Args:
        gaussians: of a map; empty slots don't count.
    """
    valid = np.asarray(gaussians.valid)
    fields = (
        gaussians.means,
        gaussians.quaternions,
        gaussians.log_scales,
        gaussians.opacity_logits,
        gaussians.sh,
    )
    finite = [np.isfinite(np.asarray(field)).reshape(len(valid), -1).all(axis=1) for field in fields]
    return int((valid & ~np.all(finite, axis=0)).sum())


class _Rows:
    """Prints a row each so many steps of the refinement."""

    def __init__(self, name: str, every: int) -> None:
        self._name, self._every = name, every
        self._start, self._programs, self._counted = 0.0, 0, 0

    def compiled(self, event: str, duration_secs: float, **_: str | int) -> None:
        """Count a program."""
        self._programs += event == _COMPILED

    def __call__(self, progress: Progress) -> None:
        """Take note of a step."""
        now = time.perf_counter()
        if progress.stage == "refinement" and progress.done == _FIRST:
            self._start, self._programs, self._counted = now, 0, _FIRST
        if progress.stage != "refinement" or progress.done % self._every:
            return
        gaussians = progress.run.gaussians
        step = 1e3 * (now - self._start) / max(1, progress.done - self._counted)
        cells = (progress.done, progress.num_gaussians, not_finite(gaussians), self._programs, f"{step:.0f}")
        print(f"| {self._name} | {' | '.join(map(str, cells))} |", flush=True)
        self._start, self._programs, self._counted = now, 0, progress.done


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="A map after ten thousand steps.")
    parser.add_argument("--recordings", nargs="+", default=list(RECORDINGS), choices=list(RECORDINGS))
    parser.add_argument("--frames", type=int, default=200, help="first frames of each recording")
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--every", type=int, default=2500, help="steps of a row")
    parser.add_argument("--max-width", type=int, default=160, help="width of the views, pixels")
    options = parser.parse_args(arguments)
    print("| recording | steps | Gaussians | not finite | compiled | ms a step |\n|---|---|---|---|---|---|")
    for name in options.recordings:
        place = RECORDINGS[name]
        if not place.startswith("synthetic") and not Path(place).exists():
            print(f"no {name}: there is no {place}", file=sys.stderr)
            continue
        recording = open_recording(place, options=ReaderOptions(end=options.frames))
        config = PRESETS[recording.dataset]
        mapping = replace(config.mapping, max_width=options.max_width, final_steps=options.steps)
        rows = _Rows(name, options.every)
        jax.monitoring.register_event_duration_secs_listener(rows.compiled)
        frames = ((number, recording[number]) for number in range(len(recording)))
        try:
            run(frames, recording.camera, replace(config, mapping=mapping), observer=rows)
        finally:
            jax.monitoring.unregister_event_duration_listener(rows.compiled)


if __name__ == "__main__":
    main()
