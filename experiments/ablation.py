"""Variants of the system beside each other, over many starts: which differences are more than chance.

    python -m experiments.ablation [--recordings NAME ...] [--variants NAME ...] [--strides 1 3 8]
        [--starts 10] [--frames N] [--csv FILE]

A recording is a name of the table below, or as of `sfgs-jax run`: a path, or `synthetic:kinect=1,seed=2`.

A start is a run of its own. Start n drops the first n frames. Even starts run forward; odd ones run backward
and drop the last n. At a stride above one the starts see other frames. Nothing is mapped.

ATE is the RMSE over all tracked frames after SE(3) alignment. RPE is of rotation, from one selected frame to
the next and over a second. Scale is the factor on the estimate that fits the truth best; noise on a short
path pulls it below 1. Two figures need no truth. One is the distance between surfaces of frames far apart in
time. The other is by how much matches of ORB miss; `experiments.pose_agreement` explains both.

± is the standard error over starts. Differences to the whole system are paired: taken on each start, then
averaged. A run that tracked fewer than half of its frames is lost. *Starts* counts the others, and errors
are over these alone. A variant that loses hard starts gains by it, so read both. *Better / worse* counts
tables where ATE differs by more than two standard errors.

With --csv every run is a line in the file as soon as it ends, and those in the file are not run again. Use
another file once the code has changed.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import jax

from experiments.ablation_runs import Key, Run, append_run, measure, read_runs
from experiments.ablation_tables import COLUMNS, TOTAL_COLUMNS, row, total_row
from experiments.held_out import HeldOut
from experiments.matching_tables import print_table
from experiments.recordings import DATA, SOURCES
from experiments.starts import InMemory, start_of
from experiments.tracking import VARIANTS
from sfgs_jax.datasets import ReaderOptions, open_recording

RECORDINGS = {
    "redkitchen": SOURCES["redkitchen"],
    "fr1_rpy": SOURCES["fr1_rpy"],
    "hospital": str(DATA / "tartanair" / "hospital_clip"),
    "kinect": "synthetic:frames=300,kinect=1",
    "noise": "synthetic:frames=300,noise=1",
}
WHOLE = next(iter(VARIANTS))


def run_recording(name: str, arguments: argparse.Namespace, done: dict[Key, Run]) -> list[Run]:
    """All runs on one recording that were asked for.

    Variants take turns on each start, so an interrupted table can be paired as far as it goes.

    Args:
        name: of the recording.
        arguments: of the command line.
        done: runs that need not be done again.
    """
    opened = open_recording(RECORDINGS.get(name, name), options=ReaderOptions(end=arguments.frames))
    recording, runs = InMemory(opened), []
    for stride in arguments.strides:
        for start in range(arguments.starts):
            selected = start_of(recording, start, stride)
            held_out = HeldOut(selected, stride)
            for variant in arguments.variants:
                key = (name, len(recording), stride, start, variant)
                if key not in done:
                    done[key] = run = measure(selected, held_out, VARIANTS[variant], key)
                    print(f"{key}: {100 * run.ate_m:.2f} cm", file=sys.stderr)
                    if arguments.csv:
                        append_run(arguments.csv, run)
                runs.append(done[key])
    # The next recording may have another size, and a process has room for a limited number of programs.
    jax.clear_caches()
    return runs


def print_tables(runs: Sequence[Run], arguments: argparse.Namespace) -> None:
    """Print a table for each recording and stride, then those over all recordings."""
    for name in arguments.recordings:
        for stride in arguments.strides:
            there = [run for run in runs if (run.recording, run.stride) == (name, stride)]
            rows = [row(there, variant, WHOLE) for variant in arguments.variants]
            print_table(f"{name}, every {stride}. of {there[0].frames} frames", COLUMNS, rows)
    strides = arguments.strides
    for some in [*((stride,) for stride in strides), strides] if len(strides) > 1 else [strides]:
        there = [run for run in runs if run.stride in some]
        rows = [total_row(there, variant, WHOLE) for variant in arguments.variants if variant != WHOLE]
        print_table(f"All recordings, strides {', '.join(map(str, some))}", TOTAL_COLUMNS, rows)


def parse(words: Sequence[str] | None = None) -> argparse.Namespace:
    """Options of the command line; the whole system is always among the variants."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="+", default=list(RECORDINGS), metavar="NAME")
    parser.add_argument("--variants", nargs="+", default=list(VARIANTS), choices=list(VARIANTS))
    parser.add_argument("--strides", nargs="+", type=int, default=[1, 3, 8])
    parser.add_argument("--starts", type=int, default=10, help="how many, from start 0 on")
    parser.add_argument("--frames", type=int, help="use the first so many frames of each recording only")
    parser.add_argument("--csv", type=Path, help="a line for each run; runs in it are not done again")
    arguments = parser.parse_args(words)
    if arguments.starts < 1 or min(arguments.strides) < 1:
        parser.error("Starts and strides are at least 1.")
    for name in arguments.recordings:
        if name not in RECORDINGS and not name.startswith("synthetic") and not Path(name).exists():
            parser.error(f"There is no recording {name}; names are {', '.join(RECORDINGS)}.")
    arguments.variants = [WHOLE, *(name for name in arguments.variants if name != WHOLE)]
    return arguments


def main(words: Sequence[str] | None = None) -> None:
    """Do the runs that are missing and print the tables."""
    arguments = parse(words)
    done = {run.key: run for run in read_runs(arguments.csv)} if arguments.csv else {}
    runs = [run for name in arguments.recordings for run in run_recording(name, arguments, done)]
    print_tables(runs, arguments)


if __name__ == "__main__":
    main()
