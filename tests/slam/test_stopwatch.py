"""Stage times: the first entry holds the compilation and stays out of the medians."""

import time

import pytest

from sfgs_jax.slam import Stopwatch


def test_summary_of_known_times(monkeypatch):
    clock = iter([0.0, 1.0, 11.0, 20.0, 20.1, 30.0, 30.3])
    monkeypatch.setattr(time, "perf_counter", lambda: next(clock))
    watch = Stopwatch()
    for _ in range(3):
        with watch("tracking"):
            pass
    summary = watch.summary()["tracking"]
    assert summary["first_ms"] == 10_000
    assert summary["median_ms"] == pytest.approx(200)
    assert summary["p95_ms"] == pytest.approx(290)
    assert summary["total_s"] == pytest.approx(10.4)
    assert summary["count"] == 3


def test_a_stage_that_fails_is_counted_all_the_same():
    watch = Stopwatch()
    with pytest.raises(ZeroDivisionError), watch("mapping"):
        _ = 1 / 0
    assert watch.summary()["mapping"]["count"] == 1
