"""Crashes of a small run: each leaves the state before or after it, and the run ends in the same files.

The command `python -m experiments.crash --kills 200` runs all parts. It exits with 1 if one finds a defect.

- Every call of `open`, `write`, `fsync` and `replace` that saving makes fails, once and from then on.
- The power is lost at every change of the disk, and with it whatever was not forced there.
- Every file of a saved state is cut at every 4 KiB, and bits of it are flipped.
- The n-th of these calls fails while the outputs are written, and while a whole run goes on.
- Runs are killed at random instants of their CPU time, and taken up again until they end.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from experiments.crash_faults import CALLS
from experiments.crash_kills import killed_runs
from experiments.crash_outputs import failing_outputs, stopped_run
from experiments.crash_states import damaged_states, failing_saves, lost_writes
from sfgs_jax import slam
from sfgs_jax.arrays import enable_cache
from sfgs_jax.cli import main as command
from sfgs_jax.datasets import SyntheticRecording

_PARTS = ("calls", "power", "damage", "outputs", "kills")
_ARGUMENTS = (
    "synthetic:frames=6,width=80,height=60", "--mapping.capacity=8192", "--mapping.pair-capacity=32768",
    "--mapping.final-steps=3", "--mapping.views-in-memory=1", "--tracking.gicp.levels=1",
    "--checkpoint-interval=3", "--quiet",
)  # fmt: skip
"""A run with three steps of refinement."""


def _two_points() -> tuple[slam.Run, slam.Run]:
    """A small run at a frame, and at its end."""
    recording = SyntheticRecording(num_frames=6, width=80, height=60)
    preset = slam.PRESETS["synthetic"]
    config = replace(
        preset,
        tracking=replace(
            preset.tracking,
            gicp=replace(preset.tracking.gicp, levels=1, strides=(1,)),
            keyframe_translation=0.03,
        ),
        mapping=replace(preset.mapping, capacity=8192, pair_capacity=32768, final_steps=2, view_interval=2),
    )
    frames = [(i, recording[i]) for i in range(len(recording))]
    before = slam.run(frames[:3], recording.camera, config)
    return before, slam.run(frames, recording.camera, config)


def _report(title: str, outcomes: Iterable[tuple[str, str]], held: tuple[str, ...]) -> int:
    """Print how often each outcome occurred and all defects; returns the number of defects."""
    counts: Counter[str] = Counter()
    for what, outcome in outcomes:
        counts[outcome if outcome in held else "defect"] += 1
        if outcome not in held:
            print(f"{title}: {what}: {outcome}", flush=True)
    print(f"{title}: {sum(counts.values())}, " + ", ".join(f"{n} {name}" for name, n in counts.items()))
    return counts["defect"]


def _with_stages(runs: Iterable[tuple[list[str], str]]) -> Iterator[tuple[str, str]]:
    """Outcomes of killed runs; prints each of them, and at the end the stages that the kills fell into."""
    stages: Counter[str] = Counter()
    for killed_in, outcome in runs:
        stages.update(killed_in)
        print(f"{sum(stages.values())} kills: {outcome} after {'; '.join(killed_in)}", flush=True)
        yield "a run", outcome
    print("killed in " + ", ".join(f"{stage} {n}" for stage, n in stages.most_common()))


def main() -> int:
    """Run the experiment."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--parts", nargs="+", choices=_PARTS, default=_PARTS, help="what to do")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--flips", type=int, default=20, help="flipped bits in each file")
    parser.add_argument("--losses", type=int, default=8, help="random losses at each change of the disk")
    parser.add_argument("--every", type=int, default=1, help="every n-th call that fails in the outputs")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    enable_cache()
    defects = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if set(options.parts) - {"outputs", "kills"}:
            defects += _states(*_two_points(), folder, options)
        if "outputs" in options.parts:
            outcomes = _outputs(folder, options.every)
            defects += _report("failing outputs", outcomes, ("same files", "not reached"))
        if "kills" in options.parts:
            runs = _with_stages(killed_runs(options.kills, folder, options.seed))
            defects += _report("killed runs", runs, ("same files",))
    return 1 if defects else 0


def _outputs(folder: Path, every: int) -> Iterator[tuple[str, str]]:
    """A call that fails while outputs are written, and in a whole run."""
    whole, stopped = folder / "whole", folder / "stopped"
    stopped_run(_ARGUMENTS, stopped, step=3)
    command(["run", *_ARGUMENTS, "--out", str(whole)])
    for first in (stopped, None):
        for call in CALLS:
            for for_ever in (False, True):
                n, outcome = 1, ""
                while outcome != "not reached":
                    case = (call, n, for_ever)
                    ((what, outcome),) = failing_outputs(_ARGUMENTS, first, whole, folder / "again", [case])
                    yield f"{what}, {'the outputs' if first else 'the whole run'}", outcome
                    n += every


def _states(before: slam.Run, after: slam.Run, folder: Path, options: argparse.Namespace) -> int:
    """The parts that save states; returns the number of defects."""
    defects = 0
    if "calls" in options.parts:
        defects += _report("failing calls", failing_saves(before, after, folder), ("before", "after"))
    if "power" in options.parts:
        power = lost_writes((before, after), folder, seed=options.seed, count=options.losses)
        defects += _report("losses of power", power, ("before", "after", "saved"))
    if "damage" in options.parts:
        damages = damaged_states(after, folder / "state", flips=options.flips, seed=options.seed)
        defects += _report("damaged files", damages, ("refused",))
    return defects


if __name__ == "__main__":
    sys.exit(main())
