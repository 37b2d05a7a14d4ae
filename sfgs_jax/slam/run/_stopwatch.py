"""Wall-clock times of the stages of a run."""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np


class Stopwatch:
    """Collects how long each stage took.

    The first entry of a stage holds its compilation; the summaries leave it out where there are others.
    """

    def __init__(self) -> None:
        self._seconds: dict[str, list[float]] = defaultdict(list)
        self._start = time.perf_counter()

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._seconds[name].append(time.perf_counter() - start)

    @property
    def elapsed(self) -> float:
        """Seconds since the stopwatch was made."""
        return time.perf_counter() - self._start

    def total(self, name: str) -> float:
        """Seconds spent in a stage so far."""
        return sum(self._seconds[name], 0.0)

    def summary(self) -> dict[str, dict[str, float]]:
        """Median and 95th percentile in milliseconds, total in seconds and count of every stage."""
        return {name: _summarise(seconds) for name, seconds in sorted(self._seconds.items()) if seconds}


def _summarise(seconds: list[float]) -> dict[str, float]:
    warm = np.asarray(seconds[1:] or seconds) * 1e3
    return {
        "median_ms": round(float(np.median(warm)), 3),
        "p95_ms": round(float(np.percentile(warm, 95)), 3),
        "first_ms": round(seconds[0] * 1e3, 3),
        "total_s": round(sum(seconds), 3),
        "count": len(seconds),
    }
