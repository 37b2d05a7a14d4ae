"""Mapping in a thread of its own, on the time that tracking leaves."""

import queue
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from sfgs_jax.slam.mapping import follow_keyframes, insert_view, optimise_once
from sfgs_jax.slam.state import MapState, SlamState, View
from sfgs_jax.slam.stopwatch import Stopwatch

_PATIENCE_S = 0.05


class Mapper:
    """Owns a run's map while it lives: takes views and poses, and optimises in between."""

    def __init__(self, state: SlamState, stopwatch: Stopwatch) -> None:
        """Start the thread.

        Args:
            state: the run so far; its settings, camera and map are taken.
            stopwatch: times the stages `view` and `mapping`.
        """
        self._config, self._camera = state.config, state.mapping_camera
        self._stopwatch = stopwatch
        self._mapping = state.mapping
        self._inbox: queue.SimpleQueue[tuple[SlamState, View | None]] = queue.SimpleQueue()
        self._ended, self._free = threading.Event(), threading.Event()
        self._free.set()
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="mapper", daemon=True)
        self._thread.start()

    @property
    def mapping(self) -> MapState:
        """The map as it is by now."""
        return self._mapping

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """While this lasts no optimisation step begins: a frame is being tracked."""
        self._free.clear()
        try:
            yield
        finally:
            self._free.set()

    def learn(self, state: SlamState, view: View | None) -> None:
        """Hand over where the keyframes are, and a view if there is one.

        Raises:
            Whatever ended the thread, if something did.
        """
        if self._failure is not None:
            raise self._failure
        self._inbox.put((state, view))

    def stop(self) -> MapState:
        """End the thread after what it has been handed; the map."""
        self._ended.set()
        self._free.set()
        self._thread.join()
        if self._failure is not None:
            raise self._failure
        return self._mapping

    def _work(self) -> None:
        try:
            while not (self._ended.is_set() and self._inbox.empty()):
                self._take_in()
                if not self._mapping.views:
                    self._ended.wait(_PATIENCE_S)
                elif not self._ended.is_set() and self._free.wait(_PATIENCE_S):
                    self._optimise()
        except BaseException as error:
            self._failure = error

    def _take_in(self) -> None:
        """Everything that has been handed over; of the poses only the newest matter."""
        state, views = None, []
        while not self._inbox.empty():
            state, view = self._inbox.get()
            views += [view] if view is not None else []
        if state is None:
            return
        with self._stopwatch("view"):
            mapping = follow_keyframes(self._mapping, state.keyframe_poses)
            for view in views:
                mapping, _ = insert_view(mapping, view, self._camera, self._config.mapping)
        self._mapping = mapping

    def _optimise(self) -> None:
        with self._stopwatch("mapping"):
            config = self._config.mapping
            self._mapping, _ = optimise_once(
                self._mapping,
                self._camera,
                config,
                newest_share=config.newest_share,
                seed=self._config.seed,
            )
