"""How long work shows itself: a bar on a terminal, plain lines elsewhere, nothing when quiet."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

PLAIN_INTERVAL_SECONDS = 5.0


@runtime_checkable
class Reporter(Protocol):
    """Shows how far a piece of work is."""

    def __call__(self, done: int, details: str = "") -> None:
        """Say that `done` units are done, with a few words on the state of things."""
        ...


@contextmanager
def reporting(task: str, total: int, *, quiet: bool) -> Iterator[Reporter]:
    """Show the progress of a task of `total` units."""
    if quiet:
        yield lambda done, details="": None
    elif sys.stderr.isatty():
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[details]}"),
        )
        with Progress(*columns, console=Console(stderr=True)) as progress:
            bar = progress.add_task(task, total=total, details="")
            yield lambda done, details="": progress.update(bar, completed=done, details=details)
    else:
        yield _PlainLines(task, total)


class _PlainLines:
    """A line every few seconds, and one when the last unit is done."""

    def __init__(self, task: str, total: int) -> None:
        self._task, self._total, self._last = task, total, time.monotonic()
        self._complete = False

    def __call__(self, done: int, details: str = "") -> None:
        now = time.monotonic()
        finishing = done >= self._total and not self._complete
        if not finishing and now - self._last < PLAIN_INTERVAL_SECONDS:
            return
        self._last, self._complete = now, done >= self._total
        print(f"{self._task} {done}/{self._total} {details}".rstrip(), file=sys.stderr, flush=True)
