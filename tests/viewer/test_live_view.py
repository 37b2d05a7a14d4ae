"""The page of a run that goes on, in a browser: what it shows, its controls, and what must not disturb a run."""

import logging
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.splatting import RenderConfig, render
from sfgs_jax.viewer import LiveView
from tests.viewer.browser import OpenPage, similarity
from tests.viewer.made_up_runs import first_state, progress_of

NUM_FRAMES = 12
BACKGROUND = 20 / 255
"""Of the page in its dark colours."""


class MadeUpRun(threading.Thread):
    """Tells an observer of frames, one after another, until it raises KeyboardInterrupt."""

    def __init__(self, reports: Iterator[slam.Progress], observer: slam.Observer) -> None:
        super().__init__(daemon=True)
        self._reports, self._observer = reports, observer
        self.begun, self.interrupted = 0, False
        self.result: slam.Run | None = None

    def run(self) -> None:
        try:
            for report in self._reports:
                self.begun, self.result = report.done, report.run
                self._observer(report)
        except KeyboardInterrupt:
            self.interrupted = True


@pytest.fixture(scope="module")
def recording() -> SyntheticRecording:
    return SyntheticRecording(num_frames=NUM_FRAMES, width=80, height=60)


@pytest.fixture(scope="module")
def state(recording) -> slam.SlamState:
    return first_state(recording)


@pytest.fixture
def saved() -> list[int]:
    """Numbers of frames after which the results were saved."""
    return []


@pytest.fixture
def view(recording, saved, free_port):
    """A view with short intervals, which is closed at the end."""
    with LiveView(
        num_frames=NUM_FRAMES,
        ground_truth=recording.ground_truth,
        save=lambda run: saved.append(run.num_frames),
        name="made up",
        port=free_port,
        interval_s=0.1,
    ) as view:
        yield view


@pytest.fixture
def page(browser, view):
    """The page in a browser; at the end its console holds no errors."""
    page = OpenPage(browser, view.server.get_port(), width=1200, height=420)
    yield page
    page.close()
    assert page.errors == []


def until(condition, timeout_s: float = 30) -> None:
    """Wait for something to be true."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def test_the_page_shows_the_run_and_controls_it(page, view, recording, state, saved):
    view.control.pause()
    run = MadeUpRun(progress_of(recording, state), view)
    page.wait_for_text("Compiling")
    run.start()
    page.wait_for_text(f"Frame 1 of {NUM_FRAMES}")
    page.wait_for_text("4,800")  # Gaussians
    assert run.begun == 1

    page.press("Step")
    page.wait_for_text(f"Frame 2 of {NUM_FRAMES}")
    page.press("Save")
    page.wait_for_text("Saved after 2 frames")
    assert (run.begun, saved) == (2, [2])

    page.press("Resume")
    run.join()
    view.control.pause()
    page.wait_for_text(f"Frame {NUM_FRAMES} of {NUM_FRAMES}")
    page.wait_for_text("0.00 cm")  # error of the true poses
    assert not run.interrupted

    view.finish(run.result, "Results: here")
    page.wait_for_text(f"The run has ended: {NUM_FRAMES} of {NUM_FRAMES} frames tracked")
    page.wait_for_text("Results: here")
    assert page.page.get_by_role("button", name="Stop").is_disabled()
