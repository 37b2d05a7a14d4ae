"""`sfgs-jax check`: a look at a recording before a run."""

import dataclasses
import json
from typing import Annotated

import tyro

from sfgs_jax.cli._progress import reporting
from sfgs_jax.datasets import LAYOUTS, ReaderOptions, open_recording
from sfgs_jax.evaluation.recording_check import Finding, RecordingCheck, check_recording

_MARKS = {"good": "ok", "unknown": "open", "warning": "WARNING"}


@dataclasses.dataclass(frozen=True)
class CheckArguments:
    """Look for what would spoil a run: depth's scale, place and time, poses, lens, exposure, blur."""

    source: tyro.conf.Positional[str]
    """Folder or file of the recording, or the built-in room, as for `sfgs-jax run`."""
    dataset: Annotated[
        str | None,
        tyro.conf.arg(help=f"Layout of the recording: {', '.join(LAYOUTS)}. None recognises it."),
    ] = None
    json: bool = False
    """Print the findings as JSON, with all measured numbers."""
    reader: ReaderOptions = dataclasses.field(default_factory=ReaderOptions)
    """Units, intrinsics and choice of frames."""


def check_command(arguments: list[str]) -> int:
    """Run the command; see CheckArguments.

    Returns:
        The exit status: 1 if something would spoil a run.
    """
    options = tyro.cli(CheckArguments, prog="sfgs-jax check", args=arguments)
    recording = open_recording(options.source, dataset=options.dataset, options=options.reader)
    with reporting(quiet=options.json) as report:
        check = check_recording(
            recording, progress=lambda done, total: report("looking at frame", done, total)
        )
    print(json.dumps(dataclasses.asdict(check), indent=2) if options.json else check_text(check))
    return 1 if check.warnings else 0


def check_text(check: RecordingCheck) -> str:
    """The findings as lines, warnings last.

    Args:
        check: of a recording.
    """
    order = sorted(check.findings, key=lambda finding: finding.severity == "warning")
    width = max(len(finding.question) for finding in order)
    lines = [f"{check.name} ({check.dataset})"]
    lines += [f"{'note':<8} {'reader':<{width}}  {note}" for note in check.notes]
    for finding in order:
        lines += _lines(finding, width)
    count = len(check.warnings)
    if not count:
        return "\n".join([*lines, "Nothing was found that would spoil a run."])
    return "\n".join([*lines, f"{count} warning{'s' if count > 1 else ''}: a run would suffer from this."])


def _lines(finding: Finding, width: int) -> list[str]:
    lines = [f"{_MARKS[finding.severity]:<8} {finding.question:<{width}}  {finding.message}"]
    if finding.advice:
        lines.append(f"{'':<8} {'':<{width}}  {finding.advice}")
    return lines
