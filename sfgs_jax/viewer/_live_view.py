"""A run in progress in the browser: an observer that hands its newest state to a thread of its own."""

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import TracebackType

from sfgs_jax.geometry import Frame, Trajectory
from sfgs_jax.slam import Progress, Run
from sfgs_jax.viewer._live_display import LiveDisplay, Snapshot
from sfgs_jax.viewer._live_page import LivePage
from sfgs_jax.viewer._live_plots import History
from sfgs_jax.viewer._live_scene import LiveScene
from sfgs_jax.viewer._run_control import RunControl
from sfgs_jax.viewer._server import embedded, page_address, start_server

_log = logging.getLogger(__name__)

_TICK_S = 0.4
"""Seconds between two looks for news. The camera and the headline move with each."""

_CPU_REST, _LONGEST_REST = 20.0, 60.0
"""Rest after an update, as multiples of its duration: processor time that the run has had since, or else
wall time. A busy machine gives the run little time, and then updates are rare."""


class LiveView:
    """Shows a run in the browser while it goes on; an observer of `slam.run`.

    A thread sends the newest state to the browsers every few seconds, and nothing while none is connected.
    An error there is logged once, and the run goes on. Results don't depend on the view, to the bit.

    The attribute `server` is viser's, and `control` pauses, steps and stops the run.

    Args:
        num_frames: frames of the recording, if that is known.
        ground_truth: true path, drawn beside the estimate and compared with it; the run does not see it.
        save: writes the results so far when the page's button asks for it, in the run's thread.
        name: title of the page.
        port: port to listen on; the next free one is taken if it is in use.
        host: address to listen on; "0.0.0.0" lets other machines look and stop the run, without password.
        interval_s: least time between two updates of the map, seconds.
        max_gaussians: Gaussians that are drawn while the run goes on, those that cover most. All are drawn at
            its end.
    """

    def __init__(
        self,
        *,
        num_frames: int | None = None,
        ground_truth: Trajectory | None = None,
        save: Callable[[Run], None] | None = None,
        name: str = "sfgs-jax",
        port: int = 8080,
        host: str = "127.0.0.1",
        interval_s: float = 2.0,
        max_gaussians: int = 100_000,
    ) -> None:
        self._save, self._interval_s, self._num_frames = save, interval_s, num_frames
        self.server = start_server(host, port, name)
        self.control = RunControl(self._write)
        scene, self._history = LiveScene(self.server), History()
        self._page = LivePage(
            self.server,
            scene,
            self.control,
            name=name,
            with_truth=ground_truth is not None,
            with_saving=save is not None,
        )
        self._display = LiveDisplay(
            self.server,
            scene,
            self._page,
            self._history,
            truth=ground_truth,
            max_gaussians=max_gaussians,
        )
        self._newest: Snapshot | None = None
        self._frame: Frame | None = None
        self._complained = False
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="live view", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Address to open in a browser."""
        return page_address(self.server)

    def _repr_html_(self) -> str:
        """The page in a notebook's cell."""
        return embedded(self.address)

    def __call__(self, progress: Progress) -> None:
        """Take note of a frame or of a final map step; wait here while the run is paused.

        Raises:
            KeyboardInterrupt: the page's button asked the run to stop.
        """
        self._history.add(progress)
        if progress.frame is not None:
            self._frame = progress.frame
        headline, share = self._headline(progress)
        self._newest = self._snapshot(progress.run, headline, share, urgent=self.control.paused)
        self.control.pass_through(progress.run)

    def finish(self, run: Run, message: str = "") -> None:
        """Show the results of a run that has ended, and say so on the page.

        Args:
            run: the run.
            message: more words for the page, for instance the folder of the results.
        """
        tracked = f"{len(run.state.log.timestamps)} of {run.num_frames} frames tracked"
        headline = f"The run has {'been stopped' if run.interrupted else 'ended'}: {tracked}"
        self._newest = self._snapshot(run, headline, 1.0, urgent=True, ended=True)
        if message:
            self._page.note(message)

    def wait_for_browsers(self) -> None:
        """Return when the last update has been sent and no browser looks at the page."""
        while self.server.get_clients():
            time.sleep(_TICK_S)

    def close(self) -> None:
        """End the thread and the server."""
        self._closed.set()
        self._thread.join()
        self.server.stop()

    def __enter__(self) -> "LiveView":
        """Itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close it; if an error ended the run, the page says so."""
        if isinstance(error, Exception):
            self._page.end("The run has failed")
            self.server.flush()
        self.close()

    def _headline(self, progress: Progress) -> tuple[str, float]:
        """What the run is doing, and the share of it that is done."""
        run, config = progress.run, progress.run.config.mapping
        if progress.stage == "frames":
            lost = progress.info is not None and not progress.info.tracked
            total, share = self._num_frames, run.num_frames / (self._num_frames or math.inf)
            words = "Lost at frame" if lost else "Frame"
        else:
            total, share = None if config.final_seconds else config.final_steps, run.refined_share
            words = "Refining the map, step"
        of = "" if total is None else f" of {total}"
        return f"{words} {progress.done}{of}", share

    def _snapshot(
        self, run: Run, headline: str, share: float, *, urgent: bool, ended: bool = False
    ) -> Snapshot:
        steps = run.num_frames + run.num_refined
        return Snapshot(run.state, self._frame, headline, share, steps, urgent=urgent, ended=ended)

    def _write(self, run: Run) -> None:
        if self._save is None:
            return
        try:
            self._save(run)
        except Exception as error:
            _log.warning("the results so far could not be written: %s", error)
            self._page.note(f"The results could not be written: {error}")
        else:
            self._page.note(f"Saved after {run.num_frames} frames.")

    def _work(self) -> None:
        moved = shown = None
        pace = _Pace(self._interval_s)
        while not self._closed.wait(_TICK_S):
            newest = self._newest
            if newest is None or newest is shown or not self.server.get_clients():
                continue
            try:
                if newest is not moved:
                    moved = newest
                    self._display.move(newest)
                if newest.urgent or pace.is_due():
                    shown = newest
                    with pace.update():
                        self._display.show(newest)
            except Exception:
                if not self._complained:
                    _log.exception("The live view has failed. The run goes on, and this is not said again.")
                self._complained = True


class _Pace:
    """Says when the next update is due, so that updates take a small share of the run's time.

    Args:
        interval_s: least time between two updates, seconds.
    """

    def __init__(self, interval_s: float) -> None:
        self._interval_s = interval_s
        # The shortest of the last ones counts: others compiled, as the first does, or waited for a processor.
        self._durations: deque[float] = deque(maxlen=8)
        self._end = self._end_cpu = 0.0

    def is_due(self) -> bool:
        """True if the last update is long enough ago."""
        wall, cpu = time.monotonic() - self._end, time.process_time() - self._end_cpu
        duration = min(self._durations, default=0.0)
        rested = cpu >= _CPU_REST * duration or wall >= _LONGEST_REST * duration
        return wall >= self._interval_s and rested

    @contextmanager
    def update(self) -> Iterator[None]:
        """Time an update."""
        start = time.monotonic()
        try:
            yield
        finally:
            first = not self._end
            self._end, self._end_cpu = time.monotonic(), time.process_time()
            if not first:
                self._durations.append(self._end - start)
