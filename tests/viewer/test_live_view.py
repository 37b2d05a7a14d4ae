"""The page of a run that goes on, in a browser: what it shows, its controls, and runs undisturbed by it."""

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
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import RenderConfig, render
from sfgs_jax.viewer import LiveView
from tests.viewer.browser import OpenPage, similarity
from tests.viewer.made_up_runs import first_state, progress_of

NUM_FRAMES = 12
BACKGROUND = 20 / 255
"""Grey level behind the scene."""


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


def until(condition, timeout_s: float = 30) -> None:
    """Wait for something to be true."""
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.02)


def hide_all_but_the_map(page: OpenPage, view: LiveView) -> None:
    for layer in ("Path", "Uncertainty", "Ground truth", "Keyframes", "Loops", "Camera"):
        page.tick(layer, on=False)
        node = view.server.scene.get_handle_by_name(f"/live/marks/{layer}".lower().replace(" ", "_"))
        until(lambda node=node: not node.visible)


def look_from(view: LiveView, pose: np.ndarray, field_of_view: float) -> None:
    """Put the only browser's camera at a pose without rotation."""
    (client,) = view.server.get_clients().values()
    with client.atomic():
        client.camera.fov = field_of_view
        client.camera.wxyz, client.camera.position = (1, 0, 0, 0), pose[:3, 3]


def render_of(state: slam.SlamState, pose: np.ndarray, field_of_view: float, shape: tuple) -> np.ndarray:
    """The map's own render over the colour of the page."""
    height, width, _ = shape
    focal = height / (2 * np.tan(field_of_view / 2))
    camera = Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width=width, height=height)
    config = RenderConfig(pair_capacity=131_072)
    background = jnp.full(3, BACKGROUND)
    drawn = render(state.gaussians, camera, se3.from_matrix(pose), background, config=config)
    assert int(drawn.overflow) == 0
    # The map covers most of the page, so that its background does not decide.
    assert float(jnp.mean(drawn.alpha > 0.5)) > 0.5
    return np.asarray(drawn.rgb)


def test_the_page_shows_the_run_and_controls_it(browser, view, recording, state, saved):
    page = OpenPage(browser, view.server.get_port(), width=1040, height=300)
    page.wait_for_text("Compiling")
    view.control.pause()
    run = MadeUpRun(progress_of(recording, state), view)
    run.start()
    page.wait_for_text(f"Frame 1 of {NUM_FRAMES}")
    page.wait_for_text("4,800")  # Gaussians
    assert run.begun == 1

    hide_all_but_the_map(page, view)
    pose, field_of_view = np.eye(4), np.radians(50)
    pose[:3, 3] = (0.02, 0, -0.1)
    look_from(view, pose, field_of_view)
    assert min(page.canvas().shape[:2]) > 250
    expected = render_of(state, pose, field_of_view, page.canvas().shape)
    until(lambda: similarity(page.canvas(), expected) > 0.9)

    page.press("Step")
    page.wait_for_text(f"Frame 2 of {NUM_FRAMES}")
    page.press("Save")
    page.wait_for_text("Saved after 2 frames")
    assert (run.begun, saved) == (2, [2])

    # A browser that comes later sees the same, and one that goes is not missed.
    other = OpenPage(browser, view.server.get_port(), width=800, height=300)
    other.wait_for_text(f"Frame 2 of {NUM_FRAMES}")
    other.wait_for_text("4,800")
    assert page.errors == []
    page.close()
    other.press("Resume")
    run.join(timeout=20)
    other.wait_for_text(f"Frame {NUM_FRAMES} of {NUM_FRAMES}")
    assert not run.interrupted

    # A folder's name is text on the page, no HTML.
    hostile = "Results: <img src=x onerror=document.title='X'> [a](b) {c} *d* in r_1"
    view.finish(run.result, hostile)
    other.wait_for_text(f"The run has ended: {NUM_FRAMES} of {NUM_FRAMES} frames tracked")
    other.wait_for_text(hostile)
    other.wait_for_text("0.00 cm")  # error of the true poses
    assert other.page.get_by_role("button", name="Stop").is_disabled()
    assert other.errors == []
    other.close()
    view.wait_for_browsers()


def test_stop_ends_the_run_as_an_interruption(view, recording, state):
    view.control.stop()
    run = MadeUpRun(progress_of(recording, state), view)
    run.start()
    run.join(timeout=20)
    assert run.interrupted
    assert run.begun == 1


def test_a_failure_of_the_view_is_logged_once_and_the_run_goes_on(
    view, recording, state, caplog, monkeypatch
):
    monkeypatch.setattr(view.server, "get_clients", lambda: {0: None})  # as if a browser looked
    (view_of_map,) = state.mapping.views
    lost = replace(view_of_map, keyframe=7)  # there is no such keyframe
    broken = replace(state, mapping=replace(state.mapping, views=(lost,)))
    with caplog.at_level(logging.ERROR, logger="sfgs_jax"):
        run = MadeUpRun(progress_of(recording, broken), view)
        view.control.pause()
        run.start()
        until(lambda: caplog.records)
        view.control.step()
        time.sleep(0.5)
        view.control.resume()
        run.join(timeout=20)
    assert run.begun == NUM_FRAMES
    assert [record.levelname for record in caplog.records] == ["ERROR"]
    assert "The run goes on" in caplog.text


def test_without_a_browser_nothing_is_drawn(view, recording, state):
    run = MadeUpRun(progress_of(recording, state), view)
    run.start()
    run.join(timeout=20)
    view.finish(run.result)
    view.wait_for_browsers()
    time.sleep(0.5)
    assert run.begun == NUM_FRAMES
    assert view.server.scene.get_handle_by_name("/live/map/splats") is None


def test_a_port_in_use_gives_the_next_free_one(view):
    port = view.server.get_port()
    with LiveView(port=port) as other:
        assert other.server.get_port() > port
        assert other.address == f"http://127.0.0.1:{other.server.get_port()}"
        assert f'src="{other.address}"' in other._repr_html_()


def test_results_that_cannot_be_written_are_told(free_port, state, caplog):
    def fail(run: slam.Run) -> None:
        raise OSError("the disk is full")

    with LiveView(save=fail, port=free_port) as view:
        view.control.save()
        with caplog.at_level(logging.WARNING, logger="sfgs_jax"):
            view.control.pass_through(slam.Run(state))
    assert "the disk is full" in caplog.text
