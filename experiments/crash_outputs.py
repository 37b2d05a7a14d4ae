"""Outputs that can't be written: a run says so in one sentence; `--resume` ends in the same files."""

import io
import shutil
import tempfile
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import redirect_stderr
from pathlib import Path
from unittest import mock

from experiments.crash_faults import Faults
from sfgs_jax import slam
from sfgs_jax.cli import RunObserver, main
from sfgs_jax.slam import Progress
from sfgs_jax.slam.run import STATE_FILE

_OF_TIME = {"metrics.json", "report.html", "run.log"}
SAME_FILES = tuple(sorted({*slam.OUTPUT_FILES, slam.GROUND_TRUTH_FILE} - _OF_TIME))
"""Outputs that do not depend on the time and the place of a run."""


def other_files(out: Path, whole: Path) -> list[str]:
    """Outputs that are not those of another run, to the bit, or are missing.

    Args:
        out: folder of a run.
        whole: folder of the other.
    """
    return [name for name in SAME_FILES if _content(out / name) != _content(whole / name)]


def _content(path: Path) -> bytes | None:
    return path.read_bytes() if path.exists() else None


class _Stopped(BaseException):
    """Stands for a kill: nobody catches it."""


def stopped_run(arguments: Sequence[str], out: Path, *, step: int) -> None:
    """A run that is gone right after a step of its refinement.

    Args:
        arguments: of `sfgs-jax run`.
        out: its folder.
        step: of the refinement.
    """
    told = RunObserver.__call__

    def observe(self: RunObserver, progress: Progress) -> None:
        told(self, progress)
        if (progress.stage, progress.done) == ("refinement", step):
            raise _Stopped

    try:
        with mock.patch.object(RunObserver, "__call__", observe):
            main(["run", *arguments, "--out", str(out)])
    except _Stopped:
        return


def failing_outputs(
    arguments: Sequence[str],
    stopped: Path | None,
    whole: Path,
    folder: Path,
    cases: Iterable[tuple[str, int, bool]],
) -> Iterator[tuple[str, str]]:
    """Outcomes of runs of which a call fails; each is resumed afterwards without failures.

    Args:
        arguments: of `sfgs-jax run`.
        stopped: folder of a run that was stopped, to go on from; None runs all of it.
        whole: folder of the run without failures.
        folder: for the runs.
        cases: kind and number of the call that fails, and whether later ones fail too.

    Yields:
        The case, and "same files" where nothing is lost, or "not reached" where there were fewer calls.
        Anything else is a defect.
    """
    out, refuge = folder / "out", folder / "refuge"
    words = ["run", *arguments, "--out", str(out)]
    for call, n, for_ever in cases:
        shutil.rmtree(folder, ignore_errors=True)
        refuge.mkdir(parents=True)
        if stopped is not None:
            shutil.copytree(stopped, out)
        faults = Faults(call, n, for_ever=for_ever)
        with mock.patch.object(tempfile, "tempdir", str(refuge)), faults:
            status, told = _told([*words, "--resume"] if stopped is not None else words)
        outcome = _outcome(status, told, words, whole, out, refuge) if faults.failed else "not reached"
        yield f"{call} {n}{' and later' if for_ever else ''}", outcome


def _outcome(status: int, told: str, words: list[str], whole: Path, out: Path, refuge: Path) -> str:
    sentences = [line for line in told.splitlines() if line.startswith(("ERROR: ", "sfgs-jax: "))]
    if "Traceback" in told or len(sentences) != (status != 0):
        return f"status {status} with {told!r}"
    if (
        status != 0
        and "the results are in" in told
        and any(other_files(each, whole) for each in refuge.iterdir())
    ):
        return "other files in the refuge"
    if status != 0:
        has_checkpoint = (out / slam.STORAGE / STATE_FILE).exists()
        status, told = _told([*words, "--resume" if has_checkpoint else "--overwrite"])
    different = other_files(out, whole)
    return "same files" if status == 0 and not different else f"status {status}, other {different}: {told!r}"


def _told(words: list[str]) -> tuple[int, str]:
    """Status of a command, and all that it said to the standard error."""
    with redirect_stderr(io.StringIO()) as told:
        try:
            status = main(words)
        except Exception:
            traceback.print_exc()
            status = -1
    return status, told.getvalue()
