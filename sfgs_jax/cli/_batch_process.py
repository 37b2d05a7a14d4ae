"""One run of a batch as a process of its own, with its share of the machine's cores."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from sfgs_jax.arrays import InputError
from sfgs_jax.cli._batch_list import Entry
from sfgs_jax.cli._batch_record import State
from sfgs_jax.slam import STORAGE

_LONGEST = 300
"""Characters of a message."""
_OF_XLA = re.compile(r"[IWEF]\d{4} ")
"""Beginning of a line that XLA logs."""
_INTERRUPTED = 130
"""Exit status of `sfgs-jax run`."""
INTERRUPTED_MESSAGE = "It was interrupted, and goes on when the batch is started again."


@dataclass(frozen=True)
class RunProcess:
    """A run that goes on.

    Attributes:
        entry: its recording.
        folder: for its results.
        log: file with what it prints.
        process: the process.
        started: by the monotonic clock, seconds.
    """

    entry: Entry
    folder: Path
    log: Path
    process: subprocess.Popen[bytes]
    started: float

    @property
    def seconds(self) -> float:
        """Since its start."""
        return time.monotonic() - self.started

    def ended(self) -> bool:
        """True after its end."""
        return self.process.poll() is not None

    def stop(self) -> None:
        """Ask it to save what it has, and to end."""
        if not self.ended():
            self.process.send_signal(signal.SIGTERM)

    def end(self, *, asked: bool) -> tuple[State, str]:
        """State after the end, and a sentence on it if the run is not done; waits for the end.

        Args:
            asked: whether `stop` was called before.
        """
        status = self.process.wait()
        if status == 0:
            return "done", ""
        # Before it is ready to save anything, it just ends.
        if status == _INTERRUPTED or (asked and status == -signal.SIGTERM):
            return "interrupted", INTERRUPTED_MESSAGE
        if status < 0:
            return "failed", f"It was ended by the signal {_signal(-status)}; {self.log} has what it printed."
        return "failed", _last_message(self.log)


@dataclass(frozen=True)
class Machine:
    """This machine, whose cores its runs share.

    Attributes:
        jobs: runs at a time.
    """

    jobs: int

    def start(self, entry: Entry, folder: Path, log: Path, *, overwrite: bool) -> RunProcess:
        """Start a run with its share of the cores; see the function `start`."""
        return start(entry, folder, log, cores=max(1, available_cores() // self.jobs), overwrite=overwrite)


def start(
    entry: Entry, folder: Path, log: Path, *, cores: int, overwrite: bool, here: Path | None = None
) -> RunProcess:
    """Start a run; it goes on from its last checkpoint if there is one.

    Args:
        entry: its recording.
        folder: for its results.
        log: file for what it prints.
        cores: threads that it may compute with.
        overwrite: whether the run begins anew, whatever is in the folder.
        here: folder that relative paths begin at; the current one if not given.

    Raises:
        InputError: the log can't be written.
    """
    resume = (folder / STORAGE).is_dir() and not overwrite
    mode = "--resume" if resume else "--overwrite"
    source, *options = entry.words
    command = [sys.executable, "-m", "sfgs_jax", "run", source, "--out", str(folder), mode, *options]
    try:
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*command, "--quiet"],
                cwd=here,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=limited(dict(os.environ), cores),
                # Ctrl-C reaches the batch alone, which asks every run once.
                start_new_session=True,
            )
    except OSError as error:
        raise InputError(f"{log} cannot be written ({error.strerror}): choose another with --out.") from error
    return RunProcess(entry, folder, log, process, time.monotonic())


def limited(environment: dict[str, str], cores: int) -> dict[str, str]:
    """Environment of a process that computes with so many threads, and takes GPU memory as it needs it.

    XLA's pool of threads on the CPU has the size NPROC. Numbers that are set already stay.

    Args:
        environment: to add to.
        cores: number of threads.
    """
    threads = ("NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM")
    return {
        **dict.fromkeys(threads, str(cores)),
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",
        **environment,
    }


def available_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _last_message(log: Path) -> str:
    """The last error in a log, or its last line."""
    try:
        lines = [line.strip() for line in log.read_text(errors="replace").splitlines()]
    except OSError:
        lines = []
    lines = [line for line in lines if line and not _OF_XLA.match(line)]
    marks = ("sfgs-jax: ", "ERROR: ")
    errors = [line for line in lines if line.startswith(marks)]
    text = re.sub("^(sfgs-jax|ERROR): ", "", (errors or lines or [f"It failed; {log} is empty."])[-1])
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _signal(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:
        return str(number)
