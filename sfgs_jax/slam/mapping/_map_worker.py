"""Map workers: own a run's map while it lives, in the run's own thread or in another."""

import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import PATIENCE
from sfgs_jax.geometry import is_held_out
from sfgs_jax.slam.mapping._allowance import Allowance
from sfgs_jax.slam.mapping._map_update import (
    follow_keyframes,
    insert_view,
    map_frame,
    optimise_once,
)
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._step_info import Stages

_T = TypeVar("_T")
_Keyframes = tuple[Float[np.ndarray, "n 7"], Float[np.ndarray, "3"] | None]
"""Poses of the keyframes and times of the rows, as `follow_keyframes` takes them."""

Spill = Callable[[MapState], MapState]
"""Puts the images of old views on disk; the identity keeps them in memory."""


@runtime_checkable
class MapWorker(Protocol):
    """Owner of a run's map."""

    @property
    def mapping(self) -> MapState:
        """The map by now."""
        ...

    def frames(self, frames: Iterable[_T]) -> Iterator[_T]:
        """The frames of the run, watched for when the tracker is idle."""
        ...

    def learn(self, state: SlamState, view: View | None) -> float:
        """Take the keyframes' poses and a view after a tracked frame; the loss if it is known at once."""
        ...

    def stop(self) -> MapState:
        """Finish the views that were handed over; the map."""
        ...


class InlineMapWorker:
    """Maps in the run's own thread, between two frames; a run repeats itself to the bit."""

    def __init__(self, state: SlamState, stages: Stages, spill: Spill) -> None:
        """Take over a map.

        Args:
            state: the run so far.
            stages: times the stages `view` and `mapping`.
            spill: puts the images of old views on disk.
        """
        self._mapping, self._stages, self._spill = state.mapping, stages, spill

    @property
    def mapping(self) -> MapState:
        """The map by now."""
        return self._mapping

    def frames(self, frames: Iterable[_T]) -> Iterator[_T]:
        """The frames as they are."""
        yield from frames

    def learn(self, state: SlamState, view: View | None) -> float:
        """Insert the view and do the frame's map steps.

        Args:
            state: after a tracked frame.
            view: of that frame, if it is one.
        """
        mapping, loss = map_frame(self._mapping, state, view, stages=self._stages)
        self._mapping = self._spill(mapping)
        return loss

    def stop(self) -> MapState:
        """The map."""
        return self._mapping


class ThreadedMapWorker:
    """Maps in a thread of its own, in the time that tracking leaves.

    It inserts one view or does one map step at a time. Views can wait longer than frames. So it begins only
    while the tracker waits for a frame that is not there yet. It waits longer once many frames were late
    beside it (`MappingConfig.late_share`). Once as many views wait as have room in memory
    (`MappingConfig.views_in_memory`), it begins at once.
    """

    def __init__(
        self,
        state: SlamState,
        stages: Stages,
        spill: Spill,
        *,
        patience: float = PATIENCE,
    ) -> None:
        """Start the thread.

        Args:
            state: the run so far; its settings, camera and map are taken.
            stages: times the stages `view` and `mapping`.
            spill: puts the images of old views on disk.
            patience: seconds that the tracker waits for a frame before the thread begins.
        """
        self._config, self._camera = state.config, state.mapping_camera
        self._stages, self._spill, self._patience = stages, spill, patience
        self._mapping = state.mapping
        self._changed = threading.Condition()
        self._keyframes = (state.graph.poses, state.row_times)
        self._allowance = Allowance(state.config.mapping.late_share)
        self._keyframe_views: deque[View] = deque()
        self._other_views: deque[View] = deque()
        self._idle, self._busy, self._ended = True, False, False
        self._failure: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="mapper", daemon=True)
        self._thread.start()

    @property
    def mapping(self) -> MapState:
        """The map by now."""
        return self._mapping

    def frames(self, frames: Iterable[_T]) -> Iterator[_T]:
        """The frames; work begins only while one is waited for."""
        was_busy, asked = False, time.monotonic()
        for frame in frames:
            # A frame that is there at once came while the one before it was tracked.
            was_late = time.monotonic() - asked < self._patience
            self._allowance.frame_came(late=was_busy and was_late)
            was_busy = self._busy
            self._tell(idle=False)
            yield frame
            was_busy, asked = was_busy or self._busy, time.monotonic()
            self._tell(idle=True)

    def learn(self, state: SlamState, view: View | None) -> float:
        """Hand over the keyframes' poses, and a view if there is one.

        Args:
            state: after a tracked frame.
            view: of that frame, if it is one.

        Returns:
            NaN: the loss is not known yet.

        Raises:
            BaseException: the error that ended the thread, if one did.
        """
        if self._failure is not None:
            raise self._failure
        with self._changed:
            self._keyframes = (state.graph.poses, state.row_times)
            if view is not None:
                # Keyframes, or the frames in their places, show what the map lacks, so they go first.
                keyframe = state.graph.keyframes[view.keyframe].frame
                is_keyframe = view.frame - keyframe <= is_held_out(keyframe)
                (self._keyframe_views if is_keyframe else self._other_views).append(view)
            self._changed.notify()
        return float("nan")

    def stop(self) -> MapState:
        """End the thread after the views that were handed over; the map.

        Raises:
            BaseException: the error that ended the thread, if one did.
        """
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
                    self._wait_for_work()
                    keyframes = self._keyframes
                    waiting = self._keyframe_views or self._other_views
                    view = waiting.popleft() if waiting else None
                    self._busy = True
                if view is not None:
                    self._insert(view, keyframes)
                elif self._ended:
                    return
                else:
                    self._optimise(keyframes)
                self._busy = False
        except BaseException as error:
            self._failure = error

    def _wait_for_work(self) -> None:
        while True:
            self._changed.wait_for(self._may_begin)
            if self._has_to_begin() or not self._changed.wait_for(lambda: not self._idle, self._patience):
                return

    def _has_to_begin(self) -> bool:
        waiting = len(self._keyframe_views) + len(self._other_views)
        return self._ended or waiting > self._config.mapping.views_in_memory

    def _may_begin(self) -> bool:
        has_work = bool(self._keyframe_views or self._other_views or self._mapping.views)
        return self._has_to_begin() or (self._idle and has_work and self._allowance.is_left)

    def _insert(self, view: View, keyframes: _Keyframes) -> None:
        with self._stages("view"):
            mapping = follow_keyframes(self._mapping, *keyframes)
            mapping, _ = insert_view(mapping, view, self._camera, self._config.mapping)
            self._mapping = self._spill(mapping)

    def _optimise(self, keyframes: _Keyframes) -> None:
        config = self._config.mapping
        with self._stages("mapping"):
            self._mapping, _ = optimise_once(
                follow_keyframes(self._mapping, *keyframes),
                self._camera,
                config,
                newest_share=config.newest_share,
                seed=self._config.seed,
            )
