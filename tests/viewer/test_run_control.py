"""The gate of a run: pause, step, stop and save, asked for in one thread and done in another."""

import threading
import time

import pytest

from sfgs_jax.slam import Run
from sfgs_jax.viewer import RunControl

RUN = object.__new__(Run)
"""The gate hands it on and does not look inside."""


class Walker(threading.Thread):
    """Passes a gate again and again, and counts how often."""

    def __init__(self, control: RunControl) -> None:
        super().__init__(daemon=True)
        self.control, self.passed, self.stopped = control, 0, False

    def run(self) -> None:
        try:
            while self.passed < 10_000:
                self.control.pass_through(RUN)
                self.passed += 1
                time.sleep(0.001)
        except KeyboardInterrupt:
            self.stopped = True


@pytest.fixture
def saved() -> list:
    return []


@pytest.fixture
def walker(saved):
    walker = Walker(RunControl(saved.append))
    yield walker
    walker.control.stop()
    walker.join(timeout=10)
    assert walker.stopped


def wait_until(condition) -> None:
    end = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.005)


def test_it_lets_a_run_pass_until_it_is_paused(walker):
    walker.start()
    wait_until(lambda: walker.passed > 5)
    walker.control.pause()
    time.sleep(0.05)
    passed = walker.passed
    time.sleep(0.05)
    assert walker.passed == passed
    assert walker.control.paused
    walker.control.resume()
    wait_until(lambda: walker.passed > passed + 5)
    assert not walker.control.paused


def test_a_step_is_one_frame_each_time(walker):
    walker.control.pause()
    walker.start()
    time.sleep(0.05)
    assert walker.passed == 0
    for count in (1, 2):
        walker.control.step()
        wait_until(lambda count=count: walker.passed == count)
    walker.control.step()
    walker.control.step()
    wait_until(lambda: walker.passed == 4)
    time.sleep(0.05)
    assert walker.passed == 4


def test_a_step_pauses_a_run_that_goes(walker):
    walker.start()
    wait_until(lambda: walker.passed > 5)
    walker.control.step()
    time.sleep(0.05)
    passed = walker.passed
    time.sleep(0.05)
    assert walker.passed == passed


def test_results_are_saved_in_the_thread_of_the_run_while_it_is_paused(saved):
    threads = []

    def write(run) -> None:
        threads.append(threading.current_thread())
        saved.append(run)

    walker = Walker(RunControl(write))
    walker.control.pause()
    walker.start()
    walker.control.save()
    wait_until(lambda: saved)
    assert (saved, threads) == ([RUN], [walker])
    assert walker.passed == 0
    walker.control.stop()
    walker.join(timeout=10)
    assert walker.stopped
    assert walker.control.stopped
