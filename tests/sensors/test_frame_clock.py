"""The clock of a camera's frames, from time stamps that jitter."""

import numpy as np
import pytest

from sfgs_jax.sensors import FrameClock


def intervals(stamps) -> np.ndarray:
    """Seconds from frame to frame by the clock, without the first frame's."""
    clock, elapsed = FrameClock(), []
    for stamp in stamps:
        clock = clock.after(float(stamp))
        elapsed.append(clock.elapsed)
    assert elapsed[0] == 0
    return np.asarray(elapsed[1:])


@pytest.mark.parametrize("begin", [0, 1.3e9])
def test_even_stamps_are_believed(begin):
    found = intervals(begin + np.arange(200) / 30)
    np.testing.assert_allclose(found, 1 / 30, atol=1e-6)


def test_jitter_of_the_stamps_does_not_reach_the_intervals():
    jitter = np.random.default_rng(0).normal(0, 0.0025, 400)
    stamps = 5 + np.arange(400) * 0.0334 + jitter
    found = intervals(stamps)
    assert np.std(np.diff(stamps)) > 0.1 * 0.0334
    np.testing.assert_allclose(found[15:], 0.0334, rtol=0.03)
    np.testing.assert_allclose(found[60:], 0.0334, rtol=0.01)


def test_missing_frames_are_whole_periods():
    rng = np.random.default_rng(1)
    numbers = np.sort(rng.choice(600, 400, replace=False))
    stamps = numbers / 30 + rng.normal(0, 0.001, 400)
    periods = intervals(stamps) * 30
    np.testing.assert_allclose(periods[60:], np.diff(numbers)[60:], rtol=0.01)


@pytest.mark.parametrize("spread", [0.0, 0.5])
def test_a_change_of_the_rate_and_uneven_intervals_are_those_of_the_stamps(spread):
    shares = 1 + spread * np.random.default_rng(2).uniform(-1, 1, 300)
    wanted = np.concatenate([np.full(100, 1 / 30), shares / 22, shares / 60])
    found = intervals(np.concatenate([[0], np.cumsum(wanted)]))
    # Where intervals are uneven by chance some ten of them may look even.
    assert np.mean(abs(found / wanted - 1) < 0.02) > 0.95


def test_a_frame_of_the_same_time_is_of_an_unknown_interval():
    clock = FrameClock().after(1.0).after(1.0)
    assert clock.elapsed == 0
    assert clock.after(1.5).elapsed == 0.5
