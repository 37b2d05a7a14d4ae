"""Mapping in a thread of its own, on the time that tracking leaves."""

import threading
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from sfgs_jax.slam.mapping import follow_keyframes, insert_view, optimise_once
from sfgs_jax.slam.state import MapState, SlamState, View
from sfgs_jax.slam.stopwatch import Stopwatch
from sfgs_jax.slam.storage import spill_views

_T = TypeVar("_T")

_MOST_KEYFRAMES_WAITING = 2
"""Views of keyframes beyond which the mapper does not wait until the tracker is idle."""
_MOST_VIEWS_WAITING = 64
"""Other views beyond which the oldest is left out: another of much the same came soon after it."""


class Mapper:
    """Owns a run's map while it lives: takes views and poses, and optimises in between.

    One view is inserted or one optimisation step done at a time, and begun only while the tracker waits for
    a frame: views can wait longer than frames.
    """

    def __init__(self, state: SlamState, stopwatch: Stopwatch, *, storage: Path | None = None) -> None:
        """Start the thread.

        Args:
            state: the run so far; its settings, camera and map are taken.
            stopwatch: times the stages `view` and `mapping`.
            storage: folder for the images of old views; without one they stay in memory.
        """
        self._config, self._camera, self._storage = state.config, state.mapping_camera, storage
        self._stopwatch = stopwatch
        self._mapping = state.mapping
        self._changed = threading.Condition()
        self._keyframe_poses = state.keyframe_poses
        self._keyframe_views: deque[View] = deque()
        self._other_views: deque[View] = deque(maxlen=_MOST_VIEWS_WAITING)
        self._idle, self._ended = True, False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="mapper", daemon=True)
        self._thread.start()

    @property
    def mapping(self) -> MapState:
        """The map as it is by now."""
        return self._mapping

    def yielding(self, frames: Iterable[_T]) -> Iterator[_T]:
        """The frames; work begins only while one is waited for."""
        for frame in frames:
            self._tell(idle=False)
            yield frame
            self._tell(idle=True)

    def learn(self, state: SlamState, view: View | None) -> None:
        """Hand over where the keyframes are, and a view if there is one.

        Raises:
            Whatever ended the thread, if something did.
        """
        if self._failure is not None:
            raise self._failure
        with self._changed:
            self._keyframe_poses = state.keyframe_poses
            if view is not None:
                # What a keyframe shows is new to the map.
                is_keyframe = state.keyframes[view.keyframe].frame == view.frame
                (self._keyframe_views if is_keyframe else self._other_views).append(view)
            self._changed.notify()

    def stop(self) -> MapState:
        """End the thread after the views that it has been handed; the map."""
        self._tell(ended=True)
        self._thread.join()
        if self._failure is not None:
            raise self._failure
        return self._mapping

    def _tell(self, *, idle: bool = True, ended: bool = False) -> None:
        with self._changed:
            self._idle, self._ended = idle, ended
            self._changed.notify()

    def _work(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(self._may_begin)
                    poses = self._keyframe_poses
                    waiting = self._keyframe_views or self._other_views
                    view = waiting.popleft() if waiting else None
                if view is not None:
                    self._insert(view, poses)
                elif self._ended:
                    return
                else:
                    self._optimise(poses)
        except BaseException as error:
            self._failure = error

    def _may_begin(self) -> bool:
        if self._ended or len(self._keyframe_views) > _MOST_KEYFRAMES_WAITING:
            return True
        return self._idle and bool(self._keyframe_views or self._other_views or self._mapping.views)

    def _insert(self, view: View, keyframe_poses: Float[np.ndarray, "n 7"]) -> None:
        config = self._config.mapping
        with self._stopwatch("view"):
            mapping = follow_keyframes(self._mapping, keyframe_poses)
            mapping, _ = insert_view(mapping, view, self._camera, config)
            if self._storage is not None:
                mapping = spill_views(mapping, self._storage, config.views_in_memory)
        self._mapping = mapping

    def _optimise(self, keyframe_poses: Float[np.ndarray, "n 7"]) -> None:
        config = self._config.mapping
        with self._stopwatch("mapping"):
            self._mapping, _ = optimise_once(
                follow_keyframes(self._mapping, keyframe_poses),
                self._camera,
                config,
                newest_share=config.newest_share,
                seed=self._config.seed,
            )
