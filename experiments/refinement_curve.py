"""PSNR against seconds of refinement, from one map: with the presets, and with GS-ICP-SLAM's settings.

    python -m experiments.refinement_curve [--recordings synthetic-640 redkitchen fr1_rpy] [--seconds 60]

A recording is tracked and its map seeded once. From there the map is refined twice, for the same time. Only
map steps count as time. PSNR is that of the protocol `gs_icp`, of some views and of some held-out frames,
with the exposure that the run has estimated; GS-ICP-SLAM estimates none. In brackets: with a gain and an
offset fitted to each image.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax.datasets import ReaderOptions, Recording, open_recording
from sfgs_jax.evaluation import MapRenderer, psnr_by_protocol
from sfgs_jax.geometry import is_held_out, twists_of
from sfgs_jax.sensors import RollingShutter, SensorTiming, with_gain
from sfgs_jax.slam import PRESETS, LearningRates, MappingConfig, Progress, Run, refine, run

_SCORED = 12
"""Views and held-out frames that are scored, spread over the recording."""


def of_gs_icp_slam(config: MappingConfig) -> MappingConfig:
    """The settings of GS-ICP-SLAM's optimiser, as its code has them (Ha, Yeon and Yu, ECCV 2024).

    Args:
        config: settings of the rest.
    """
    rates = LearningRates(
        means=4e-6, quaternions=1e-3, log_scales=5e-3, opacity_logits=0.05, sh=2.5e-3, poses=0.0
    )
    optimisation = replace(
        config.optimisation,
        ssim_weight=0.2,
        depth_weight=0.01,
        estimate_exposure=False,
        momentum=0.9,
        learning_rates=rates,
    )
    return replace(config, optimisation=optimisation, first_rate=1.0, final_rate=1.0, prune_opacity=0.005)


SETTINGS = {"presets": lambda config: config, "GS-ICP-SLAM's": of_gs_icp_slam}


class _Rows:
    """Prints a row of the table after each part of the refinement."""

    def __init__(self, recording: Recording, name: str, every: float) -> None:
        self._recording, self._name, self._every, self._next = recording, name, every, every

    def __call__(self, progress: Progress) -> None:
        seconds = progress.run.refinement_ms / 1e3
        if seconds < self._next:
            return
        self._next += self._every
        self.print_row(progress.run)

    def print_row(self, refined: Run) -> None:
        """Score the map as it is now."""
        numbers = refined.state.log.numbers.tolist()
        held = [number for number in numbers if is_held_out(number)]
        views = sorted({view.frame for view in refined.state.mapping.views} & set(numbers))
        figures = [self._scored(refined, some) for some in (views, held)]
        cells = (self._name, f"{refined.refinement_ms / 1e3:.0f}", refined.num_refined, *figures)
        print(f"| {' | '.join(map(str, cells))} |", flush=True)

    def _scored(self, refined: Run, numbers: Sequence[int]) -> str:
        state = refined.state
        renderer, path = MapRenderer(state.gaussians, state.camera), state.trajectory
        rows = {number: row for row, number in enumerate(state.log.numbers.tolist())}
        gains = np.ones((len(rows), 3)) if state.gains is None else state.gains
        twists, times, found = jnp.asarray(twists_of(path), jnp.float32), state.row_times, []
        for number in numbers[:: max(1, len(numbers) // _SCORED)]:
            frame, row = self._recording[number], rows[number]
            shutter = None
            if times is not None:
                shutter = RollingShutter(twists[row], SensorTiming(*times).colour_readout)
            rgb = renderer(path.poses[row], shutter).rgb
            shown = with_gain(rgb, jnp.asarray(gains[row], jnp.float32))
            scores = psnr_by_protocol(shown, frame.rgb, frame.depth, frame.mask, rgb)
            found.append([float(scores[name]) for name in ("gs_icp", "gs_icp_exposure")])
        own, fitted = np.mean(found, axis=0)
        return f"{own:.2f} ({fitted:.2f})"


def main(arguments: list[str] | None = None) -> None:
    """Print the table of each recording."""
    parser = argparse.ArgumentParser(description="PSNR against seconds of refinement.")
    parser.add_argument("--recordings", nargs="+", default=["synthetic-640", "redkitchen", "fr1_rpy"])
    parser.add_argument("--frames", type=int, default=None, help="first frames of each recording")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each refinement")
    parser.add_argument("--every", type=float, default=10.0, help="seconds of a row")
    options = parser.parse_args(arguments)
    for name in options.recordings:
        recording = open_recording(SOURCES.get(name) or name, options=ReaderOptions(end=options.frames))
        preset = PRESETS[recording.dataset]
        seeded = replace(preset, mapping=replace(preset.mapping, final_steps=0))
        frames = ((number, recording[number]) for number in range(len(recording)))
        done = run(frames, recording.camera, seeded).state
        print(f"\n{name}\n\n| settings | seconds | steps | views dB | held out dB |\n|---|---|---|---|---|")
        for setting, of in SETTINGS.items():
            mapping = replace(of(preset.mapping), final_seconds=options.seconds)
            started = Run(replace(done, config=replace(preset, mapping=mapping)))
            rows = _Rows(recording, setting, options.every)
            rows.print_row(started)
            refine(started, rows)


if __name__ == "__main__":
    main()
