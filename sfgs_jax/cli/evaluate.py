"""`sfgs-jax eval`: the metrics and the report of a run, computed again from its files."""

import dataclasses
from pathlib import Path
from typing import Any

import tyro

from sfgs_jax.cli.cache import enable_compilation_cache
from sfgs_jax.cli.configuration import read_config
from sfgs_jax.cli.progress import reporting
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.evaluation import evaluate_run, write_report


@dataclasses.dataclass(frozen=True)
class EvalArguments:
    """Compute the metrics of a run again and rewrite its metrics.json and report.html."""

    folder: tyro.conf.Positional[Path]
    """Folder that `sfgs-jax run` wrote."""
    source: str | None = None
    """Where the recording is now, if it has moved since."""
    every: int | None = None
    """Score the images of every so manieth frame; if not given, as many as take a minute or so."""
    quiet: bool = False
    """Print nothing but errors."""


def eval_command(arguments: list[str]) -> int:
    """Run the command; see EvalArguments."""
    options = tyro.cli(EvalArguments, prog="sfgs-jax eval", args=arguments)
    config = read_config(options.folder / "config.json")
    recording = open_recording(options.source or config.source, dataset=config.dataset, options=config.reader)
    enable_compilation_cache()
    evaluate_folder(options.folder, recording, every=options.every, quiet=options.quiet)
    if not options.quiet:
        print((options.folder / "metrics.json").read_text(), end="")
    return 0


def evaluate_folder(
    folder: Path, recording: Recording, *, every: int | None = None, quiet: bool
) -> dict[str, Any]:
    """Evaluate the run in `folder` and write its report; the metrics are returned and in `metrics.json`."""
    with reporting("evaluation", len(recording), quiet=quiet) as report:
        metrics = evaluate_run(folder, recording, every=every, progress=report)
    write_report(folder, recording)
    return metrics
