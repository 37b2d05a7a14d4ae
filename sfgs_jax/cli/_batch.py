"""`sfgs-jax batch`: the runs of many recordings, side by side in processes of their own."""

import contextlib
import dataclasses
import shlex
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import tyro

from sfgs_jax.arrays import InputError, check_counts
from sfgs_jax.cli._batch_cluster import Cluster, ClusterRun
from sfgs_jax.cli._batch_list import Entry, read_list
from sfgs_jax.cli._batch_process import Machine, RunProcess, available_cores
from sfgs_jax.cli._batch_record import (
    RECORD_FILE,
    Outcome,
    batch_table,
    outcome_of,
    read_record,
    write_record,
)

_CORES_OF_A_RUN = 4
"""More of them make a run little faster."""
_POLL_S = 0.1
_INTERRUPTED = 130
"""Exit status."""

_Say = Callable[[str], None]
_Run = RunProcess | ClusterRun


@dataclasses.dataclass(frozen=True)
class BatchArguments:
    """Track and map the recordings of a list, several at once, and print one table at the end."""

    path: tyro.conf.Positional[Path]
    """Text file with a recording in each line, and options of `sfgs-jax run` after it."""
    out: Path | None = None
    """Folder for the runs, each in a folder of its own. None means `runs/LIST`, with the name of the list."""
    jobs: int | None = None
    """Runs at a time, which share the cores. None means one for every four cores, and in a cluster one for
    every thread of its workers."""
    scheduler: str | None = None
    """Address of a Dask scheduler, like `tcp://host:8786`, whose workers make the runs. None means this
    machine."""
    overwrite: bool = False
    """Start all recordings anew, also those that are finished."""
    quiet: bool = False
    """Print nothing but the table at the end."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        if self.jobs is not None:
            check_counts(self, 1, "jobs")


def batch_command(arguments: list[str]) -> int:
    """Run the command; see BatchArguments.

    Returns:
        The exit status: 1 if a recording failed, 130 after an interruption.
    """
    options = tyro.cli(BatchArguments, prog="sfgs-jax batch", args=arguments)
    entries = read_list(options.path)
    folder = options.out or Path("runs") / options.path.stem
    with _place(options, len(entries)) as place:
        batch = _Batch(entries, folder, overwrite=options.overwrite)
        interrupted = batch.run(place, _say if not options.quiet else lambda line: None)
    print(batch_table(batch.outcomes))
    if interrupted:
        print("Interrupted; the same command goes on.", file=sys.stderr)
        return _INTERRUPTED
    return 1 if any(outcome.state != "done" for outcome in batch.outcomes) else 0


@contextlib.contextmanager
def _place(options: BatchArguments, recordings: int) -> Iterator[Machine | Cluster]:
    """Where the runs are made."""
    if options.scheduler is None:
        jobs = options.jobs or max(1, available_cores() // _CORES_OF_A_RUN)
        yield Machine(min(jobs, recordings))
        return
    with contextlib.closing(Cluster(options.scheduler, options.jobs)) as cluster:
        yield cluster


class _Batch:
    """The recordings of a list with what became of them; batch.csv always holds the same."""

    def __init__(self, entries: list[Entry], folder: Path, *, overwrite: bool) -> None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"The output folder {folder} cannot be written ({error.strerror}): choose another with --out."
            ) from error
        self._folder, self._entries, self._overwrite = folder, entries, overwrite
        found = {} if overwrite else read_record(folder / RECORD_FILE)
        if not overwrite:
            for entry in entries:
                _refuse_unless_ours(entry, folder / entry.name, found.get(entry.name))
        self._outcomes = found

    @property
    def outcomes(self) -> list[Outcome]:
        """Rows of the recordings in the list that have been begun."""
        return [self._outcomes[entry.name] for entry in self._entries if entry.name in self._outcomes]

    def run(self, place: Machine | Cluster, say: _Say) -> bool:
        """Run what is not finished; gives whether it was interrupted."""
        waiting = [entry for entry in self._entries if not self._is_done(entry)]
        if skipped := len(self._entries) - len(waiting):
            say(f"{skipped} of {len(self._entries)} finished before")
        running: list[_Run] = []
        try:
            while waiting or running:
                # Workers come and go.
                while waiting and len(running) < place.jobs:
                    running.append(self._start(waiting.pop(0), place))
                time.sleep(_POLL_S)
                for run in [run for run in running if run.ended()]:
                    running.remove(run)
                    self._end(run, say)
        except KeyboardInterrupt:
            return True
        finally:
            self._stop(running, say)
        return False

    def _is_done(self, entry: Entry) -> bool:
        return entry.name in self._outcomes and self._outcomes[entry.name].state == "done"

    def _start(self, entry: Entry, place: Machine | Cluster) -> _Run:
        before = self._outcomes.get(entry.name)
        failed = before is not None and before.state == "failed"
        folder, log = self._folder / entry.name, self._folder / f"{entry.name}.log"
        run = place.start(entry, folder, log, overwrite=self._overwrite or failed)
        seconds = before.seconds if before is not None and not failed else 0.0
        self._put(Outcome(entry.name, shlex.join(entry.words), "running", seconds=seconds))
        return run

    def _end(self, run: _Run, say: _Say, *, asked: bool = False) -> None:
        state, message = run.end(asked=asked)
        seconds = self._outcomes[run.entry.name].seconds + run.seconds
        outcome = outcome_of(run.entry, run.folder, state, seconds, message)
        self._put(outcome)
        ended = sum(outcome.state != "running" for outcome in self.outcomes)
        said = f"{ended} of {len(self._entries)}: {outcome.name} {state} after {outcome.seconds:.0f} s"
        say(f"{said}: {message}" if message else said)

    def _stop(self, running: list[_Run], say: _Say) -> None:
        """End the runs that go on; a second Ctrl-C does not keep them from saving."""
        for run in running:
            run.stop()
        for run in running:
            while not run.ended():
                with contextlib.suppress(KeyboardInterrupt):
                    time.sleep(_POLL_S)
            self._end(run, say, asked=True)

    def _put(self, outcome: Outcome) -> None:
        self._outcomes[outcome.name] = outcome
        write_record(self._folder / RECORD_FILE, list(self._outcomes.values()))


def _refuse_unless_ours(entry: Entry, folder: Path, before: Outcome | None) -> None:
    """Refuse a folder that holds anything but the batch's own run of this recording.

    Raises:
        InputError: it does.
    """
    if before is None and folder.exists() and any(folder.iterdir() if folder.is_dir() else (folder,)):
        held = "something that is no run of this batch"
    elif before is not None and before.words != shlex.join(entry.words):
        held = f"a run of `{before.words}`, and not with this source and these options"
    else:
        return
    raise InputError(
        f"Line {entry.line}: {folder} holds {held}; choose another folder with --out, or pass --overwrite."
    )


def _say(line: str) -> None:
    print(line, flush=True)
