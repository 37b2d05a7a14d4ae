"""Progress of long work: a bar on a terminal, plain lines elsewhere, nothing when quiet."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

_PLAIN_INTERVAL_SECONDS = 5.0


@runtime_checkable
class Reporter(Protocol):
    """Shows the progress of one task after another."""

    def __call__(self, task: str, done: int, total: int, details: str = "") -> None:
        """Say that `done` of `total` units of a task are done, with a few words on the state of things."""
        ...


@contextmanager
def reporting(*, quiet: bool, clock: Callable[[], float] = time.monotonic) -> Iterator[Reporter]:
    """Show the progress of tasks on the standard error.

    Args:
        quiet: show nothing.
        clock: time in seconds, from any origin.
    """
    if quiet:
        yield _silence
    elif sys.stderr.isatty():
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.completed:.0f} of {task.total:.0f}"),
            TimeRemainingColumn(),
            TextColumn("{task.fields[details]}"),
        )
        with Progress(*columns, console=Console(stderr=True)) as progress:
            yield _Bars(progress)
    else:
        yield _PlainLines(clock)


def _silence(task: str, done: int, total: int, details: str = "") -> None:
    pass


class _Bars:
    """A bar for each task."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._bars: dict[str, TaskID] = {}

    def __call__(self, task: str, done: int, total: int, details: str = "") -> None:
        if task not in self._bars:
            self._bars[task] = self._progress.add_task(task, total=total, details="")
        self._progress.update(self._bars[task], completed=done, total=total, details=details)


class _PlainLines:
    """A line when a task begins and when it ends, and one every few seconds in between."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._task: str | None = None
        self._complete = False
        self._last = 0.0
        self._first = 0
        self._measured: tuple[int, float] | None = None

    def __call__(self, task: str, done: int, total: int, details: str = "") -> None:
        now = self._clock()
        beginning, ending = task != self._task, done >= total
        if beginning:
            self._task, self._complete, self._first, self._measured = task, False, done, None
        left = self._left(done, total, now)
        if not beginning and (self._complete or not ending) and now - self._last < _PLAIN_INTERVAL_SECONDS:
            return
        self._last, self._complete = now, ending
        words = [f"{task} {done} of {total}", *([left] if left else []), *([details] if details else [])]
        print(", ".join(words), file=sys.stderr, flush=True)

    def _left(self, done: int, total: int, now: float) -> str:
        """Time to the task's end, by the rate after its first unit, which may have waited for a compiler."""
        if done <= self._first or done >= total:
            return ""
        if self._measured is None:
            self._measured = done, now
            return ""
        first, start = self._measured
        seconds = (total - done) * (now - start) / max(done - first, 1)
        return f"{_duration(seconds)} left" if done > first else ""


def _duration(seconds: float) -> str:
    """Minutes and seconds as on a clock."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
