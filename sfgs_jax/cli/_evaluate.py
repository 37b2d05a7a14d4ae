"""`sfgs-jax eval`: the metrics and the report of a run, computed again from its files."""

import dataclasses
from pathlib import Path
from typing import Any

import tyro

from sfgs_jax.arrays import InputError, check_counts, enable_cache
from sfgs_jax.cli._configuration import read_config
from sfgs_jax.cli._log import logger
from sfgs_jax.cli._progress import reporting
from sfgs_jax.cli._summary import summary
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.evaluation import evaluate_run, write_report

_NEEDED = ("config.json", "trajectory.txt", "map.ply")


@dataclasses.dataclass(frozen=True)
class EvalArguments:
    """Compute the metrics of a run again and rewrite its metrics.json and report.html."""

    folder: tyro.conf.Positional[Path]
    """Folder that `sfgs-jax run` wrote."""
    source: str | None = None
    """New place of the recording, if it has moved since the run."""
    every: int | None = None
    """Score every n-th frame. None scores all frames of a short recording, and a sample of a long one."""
    quiet: bool = False
    """Print nothing but errors."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        if self.every is not None:
            check_counts(self, 1, "every")


def eval_command(arguments: list[str]) -> int:
    """Run the command; see EvalArguments."""
    options = tyro.cli(EvalArguments, prog="sfgs-jax eval", args=arguments)
    missing = next((name for name in _NEEDED if not (options.folder / name).is_file()), None)
    if missing is not None:
        raise InputError(
            f"{options.folder} is not a run folder: it has no {missing}; "
            "give the folder that `sfgs-jax run` wrote."
        )
    config = read_config(options.folder / "config.json")
    recording = open_recording(options.source or config.source, dataset=config.dataset, options=config.reader)
    try:
        enable_cache()
    except InputError as error:
        logger.warning("%s", error)
    metrics = evaluate_folder(options.folder, recording, every=options.every, quiet=options.quiet)
    if not options.quiet:
        print(summary(metrics, options.folder))
    return 0


def evaluate_folder(
    folder: Path, recording: Recording, *, every: int | None = None, quiet: bool
) -> dict[str, Any]:
    """Evaluate the run in a folder and write its report.

    Args:
        folder: the run's folder.
        recording: the recording of the run.
        every: as in `evaluate_run`.
        quiet: show no progress.

    Returns:
        The metrics, as in `metrics.json`.
    """
    total = len(recording)
    with reporting(quiet=quiet) as report:
        metrics = evaluate_run(
            folder, recording, every=every, progress=lambda done: report("evaluating, frame", done, total)
        )
    write_report(folder, recording)
    return metrics
