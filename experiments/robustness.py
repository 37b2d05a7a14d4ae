"""Perturbed recordings: share tracked, error, poses that are wrong without a word, and time to recover.

    python -m experiments.robustness [--sources room redkitchen ...] [--only "motion blur" gap] [--csv FILE]
        [--timing]

The perturbations of Robust-Ego3D with their published parameters, at severities 1, 3 and 5 and with a new
severity in each frame ("dynamic"), and faults of stream and calibration besides. The package
`experiments.perturbations` has all parameters. Frames are tracked as `sfgs-jax run` does by the preset of the
recording's layout, without a map, which does not feed back.

A frame is silently wrong if it was reported as tracked and its pose was more than 10 cm off. That is the pose
as it was given then, after alignment on the first 20. *Recovery* is the longest row of frames that were lost
or wrong, of those with something to see; "never" if the recording ends in it. Real recordings are found
through SFGS_DATA, by default `../shared`; one that is not there is left out with a line. An interrupted table
goes on with the same CSV file.
"""

import argparse
import csv
from dataclasses import asdict, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.perturbations import PERTURBATIONS, Perturbed, Severity
from experiments.recordings import DATA, SOURCES
from experiments.robustness_scores import Scores, scores
from experiments.starts import in_memory
from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import ReaderOptions, Recording
from sfgs_jax.slam import PRESETS, Run, SlamConfig, finish, follow, init

RECORDINGS = {
    "room": "synthetic:frames=240,noise=1",
    "ring": "synthetic:place=ring,frames=400,noise=1",
    "redkitchen": SOURCES["redkitchen"],
    "fr1_rpy": SOURCES["fr1_rpy"],
    "tartanair": str(DATA / "tartanair" / "hospital_clip"),
}
COLUMNS = ("perturbation", "severity", "tracked %", "AUC %", "silent-wrong %", "worst cm", "recovery")
SEED = 0


class Cell(NamedTuple):
    """Names of a row of the table."""

    source: str
    perturbation: str
    severity: Severity


def poses_of(
    recording: Perturbed, config: SlamConfig
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "n 4 4"]]:
    """Track a recording: each frame's pose as it was given, and at the end; NaN for lost frames.

    Frames of a map of their own count as lost, for nothing says where it lies to the largest.

    Args:
        recording: any.
        config: settings.
    """
    state, tracked = init(recording.camera, config), []
    live, final = np.full((2, len(recording), 4, 4), np.nan)
    for number in range(len(recording)):
        try:
            state, info, _ = follow(state, recording[number], number=number)
        except FrameError:
            # Such as a time stamp before the last one: the run goes on without the frame.
            continue
        if info.tracked:
            tracked.append(number)
            if Run(state).maps[0].rows[-1] == len(tracked) - 1:
                live[number] = np.asarray(info.T_world_cam.as_matrix())
    if not tracked:
        return live, final
    largest = Run(finish(state)).maps[0]
    rows = np.asarray(tracked, int)[largest.rows]
    final[rows] = largest.trajectory.poses
    # What was the largest map at first need not be it in the end.
    live[np.setdiff1d(np.arange(len(recording)), rows)] = np.nan
    return live, final


def measure(recording: Recording, config: SlamConfig, perturbation: str, severity: Severity) -> Scores:
    """Perturb a recording, track it and give its figures.

    Args:
        recording: with ground truth.
        config: settings of the run.
        perturbation: one of `PERTURBATIONS`.
        severity: 1 to 5, or "dynamic".
    """
    perturbed = PERTURBATIONS[perturbation].apply(recording, severity, SEED)
    live, final = poses_of(perturbed, config)
    return scores(live, final, perturbed.poses, perturbed.disturbed)


def row(cell: Cell, found: Scores) -> str:
    """A line of the Markdown table."""
    recovery = "never" if np.isnan(found.recovery) else f"{found.recovery:.0f}"
    shares = (found.tracked, found.auc, found.silent_wrong)
    words = (cell.perturbation, str(cell.severity), *(f"{100 * share:.1f}" for share in shares))
    return f"| {' | '.join((*words, f'{100 * found.worst_m:.1f}', recovery))} |"


def read_cells(path: Path | None) -> dict[Cell, Scores]:
    """The cells of a file; none without one."""
    if path is None or not path.exists():
        return {}
    found = {}
    with path.open(newline="") as file:
        for line in csv.DictReader(file):
            severity = line["severity"]
            level: Severity = "dynamic" if severity == "dynamic" else int(severity)
            cell = Cell(line["source"], line["perturbation"], level)
            found[cell] = Scores(**{name: float(line[name]) for name in Scores.__dataclass_fields__})
    return found


def append_cell(path: Path, cell: Cell, found: Scores) -> None:
    """Add a cell to a file, which begins with the names of its columns."""
    is_new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, [*Cell._fields, *Scores.__dataclass_fields__])
        if is_new:
            writer.writeheader()
        writer.writerow({**cell._asdict(), **asdict(found)})


def opened(source: str, frames: int | None) -> Recording | None:
    """A recording with its frames kept in memory; None with a line if its data is not there."""
    return in_memory(source, RECORDINGS[source], ReaderOptions(end=frames))


def main(arguments: list[str] | None = None) -> None:
    """Print a table for each recording, cell by cell."""
    parser = argparse.ArgumentParser(description="Perturbed recordings, and what becomes of their poses.")
    parser.add_argument("--sources", nargs="+", default=["room"], choices=list(RECORDINGS))
    parser.add_argument("--only", nargs="+", default=list(PERTURBATIONS), choices=list(PERTURBATIONS))
    parser.add_argument("--severities", nargs="+", choices=["1", "3", "5", "dynamic"], help="all without any")
    parser.add_argument("--frames", type=int, help="first frames of each recording; all without a number")
    parser.add_argument("--csv", type=Path, help="file of the cells; those in it are not run again")
    parser.add_argument(
        "--timing", action="store_true", help="estimate times of the rows whatever the preset"
    )
    options = parser.parse_args(arguments)
    done = read_cells(options.csv)
    for source in options.sources:
        recording = opened(source, options.frames)
        if recording is None:
            continue
        config = PRESETS[recording.dataset]
        if options.timing:
            config = replace(config, tracking=replace(config.tracking, estimate_timing=True))
        print(f"\n{source}, {len(recording)} frames\n")
        print(f"| {' | '.join(COLUMNS)} |\n|{'---|' * len(COLUMNS)}")
        silent = []
        for name in options.only:
            for severity in PERTURBATIONS[name].severities:
                if options.severities and str(severity) not in options.severities and name != "none":
                    continue
                cell = Cell(source, name, severity)
                found = done.get(cell) or measure(recording, config, name, severity)
                if options.csv is not None and cell not in done:
                    append_cell(options.csv, cell, found)
                print(row(cell, found), flush=True)
                silent += [found.silent_wrong] if severity in (1, 3) else []
        if silent:
            mean = 100 * float(np.mean(silent))
            print(f"\nsilently wrong at severities 1 and 3: {mean:.2f} % on average over {len(silent)} cells")


if __name__ == "__main__":
    main()
