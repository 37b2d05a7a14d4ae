"""Runs of a batch on the workers of a Dask cluster."""

import contextlib
import logging
import time
import uuid
from concurrent.futures import CancelledError
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.cli._batch_list import Entry
from sfgs_jax.cli._batch_process import INTERRUPTED_MESSAGE, available_cores, start
from sfgs_jax.cli._batch_record import State

if TYPE_CHECKING:
    import distributed

_POLL_S = 0.2

Ended = tuple[State, str]


@dataclass(frozen=True)
class ClusterRun:
    """A run that goes on at a worker.

    Attributes:
        entry: its recording.
        folder: for its results.
        future: what becomes of it.
        asked: set when all runs of the batch are to end.
        started: by the monotonic clock, seconds.
    """

    entry: Entry
    folder: Path
    future: "distributed.Future"
    asked: "distributed.Event"
    started: float

    @property
    def seconds(self) -> float:
        """Since its start."""
        return time.monotonic() - self.started

    def ended(self) -> bool:
        """True after its end."""
        return self.future.done()

    def stop(self) -> None:
        """Ask it to save what it has, and to end. All runs of the batch hear it."""
        # Without a scheduler nobody hears it.
        with contextlib.suppress(OSError, CancelledError):
            self.asked.set()

    def end(self, *, asked: bool) -> Ended:
        """State after the end, and a sentence on it if the run is not done; waits for the end.

        Args:
            asked: whether `stop` was called before.
        """
        try:
            return self.future.result()
        except InputError as error:
            return "failed", str(error)
        except Exception as error:
            # The run has a checkpoint.
            return "interrupted", f"The cluster lost it ({_reason(error)}). {INTERRUPTED_MESSAGE}"


def _reason(error: Exception) -> str:
    """Dask's own words for a loss are for those who know its insides."""
    import distributed

    gone = isinstance(error, CancelledError | distributed.KilledWorker | OSError)
    return "its worker or the scheduler is gone" if gone else excerpt(error)


class Cluster:
    """A Dask cluster whose workers run one recording in each of their threads."""

    def __init__(self, address: str, jobs: int | None = None) -> None:
        """Connect to a scheduler.

        Args:
            address: of the scheduler, like tcp://host:8786.
            jobs: runs at a time; one for every thread of its workers if not given.

        Raises:
            InputError: Dask is not installed, or no scheduler with a worker answers.
        """
        try:
            import dask.config
            import distributed
        except ImportError as error:
            raise InputError("Clusters need Dask: pip install 'sfgs-jax[cluster]'.") from error
        # Its loss of a connection would be a traceback.
        logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
        # Dask's own setting for how long a connection may take.
        wait = dask.config.get("distributed.comm.timeouts.connect")
        try:
            self._client = distributed.Client(address, timeout=wait, set_as_default=False)
        except (OSError, TypeError, ValueError) as error:
            raise InputError(f"No Dask scheduler answers at {excerpt(address)}.") from error
        try:
            self._client.wait_for_workers(1, timeout=wait)
        except TimeoutError as error:
            self.close()
            raise InputError(f"The scheduler at {address} has no workers.") from error
        self._jobs = jobs
        self._asked = distributed.Event(f"stop-{uuid.uuid4().hex}", client=self._client)

    @property
    def jobs(self) -> int:
        """Runs at a time; the threads of all workers that are there now, if nothing else was asked for.

        Raises:
            InputError: the scheduler is gone.
        """
        if self._jobs is not None:
            return self._jobs
        try:
            threads = cast(dict[str, int], self._client.nthreads())
        except (OSError, CancelledError) as error:
            raise InputError("The scheduler is gone. With another one the same command goes on.") from error
        return max(1, sum(threads.values()))

    def start(self, entry: Entry, folder: Path, log: Path, *, overwrite: bool) -> ClusterRun:
        """Start a run; it goes on from its last checkpoint if there is one.

        Args:
            entry: its recording.
            folder: for its results.
            log: file for what it prints.
            overwrite: whether the run begins anew, whatever is in the folder.
        """
        here = Path.cwd()
        future = self._client.submit(
            _run_at_worker,
            *(entry, here, here / folder, here / log, overwrite, self._asked.name),
            pure=False,
            key=f"{entry.name}-{uuid.uuid4().hex}",
        )
        return ClusterRun(entry, folder, future, self._asked, time.monotonic())

    def close(self) -> None:
        """End the connection; the cluster stays."""
        self._client.close()


def _run_at_worker(entry: Entry, here: Path, folder: Path, log: Path, overwrite: bool, asked: str) -> Ended:
    """Make a run in a process of its own, with a thread's share of the worker's cores."""
    import distributed

    worker = distributed.get_worker()
    if not log.parent.is_dir() or not here.is_dir():
        raise InputError(
            f"The worker {worker.address} does not see {log.parent} and {here}: a cluster needs a file "
            "system that it shares with the batch."
        )
    stop = distributed.Event(asked)
    if stop.is_set():
        return "interrupted", INTERRUPTED_MESSAGE
    cores = max(1, available_cores() // worker.state.nthreads)
    run = start(entry, folder, log, cores=cores, overwrite=overwrite, here=here)
    asked_to_end = False
    try:
        while not run.ended():
            time.sleep(_POLL_S)
            if not asked_to_end and stop.is_set():
                asked_to_end = True
                run.stop()
    finally:
        # Without a scheduler nobody waits for it: it saves what it has.
        run.stop()
    return run.end(asked=asked_to_end)
