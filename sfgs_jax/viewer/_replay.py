"""Replay of a path by the recording's own clock."""

import threading
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

_STEPS_PER_S = 25


class Replay:
    """Steps through time stamps as time passes, in a thread of its own.

    Args:
        timestamps: of the frames, seconds, ascending; at least one.
        on_frame: told the index of a frame when its time has come; called in the replay's thread.
    """

    def __init__(self, timestamps: Float[np.ndarray, " n"], on_frame: Callable[[int], None]) -> None:
        self._times, self._on_frame = timestamps - timestamps[0], on_frame
        self._lock = threading.Lock()
        self._elapsed, self._index = 0.0, 0
        self._speed = 1.0
        self._playing, self._closed = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)
        self._thread.start()

    @property
    def duration(self) -> float:
        """From the first frame to the last, seconds."""
        return float(self._times[-1])

    @property
    def playing(self) -> bool:
        """Whether time passes."""
        return self._playing.is_set()

    def time_of(self, index: int) -> float:
        """Seconds from the first frame to this one."""
        return float(self._times[index])

    def play(self, *, speed: float = 1.0) -> None:
        """Let time pass, from the frame where it stands; after the last frame the first one comes.

        Args:
            speed: seconds of the recording per second.
        """
        with self._lock:
            self._speed = speed
        self._playing.set()

    def pause(self) -> None:
        """Stop the time."""
        self._playing.clear()

    def go_to(self, index: int) -> None:
        """Set the time to that of a frame."""
        with self._lock:
            if index != self._index:
                self._elapsed, self._index = float(self._times[index]), index

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._playing.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _run(self) -> None:
        last = time.monotonic()
        while self._playing.wait() and not self._closed.wait(1 / _STEPS_PER_S):
            now = time.monotonic()
            # After a pause, the time that it took does not count.
            passed, last = min(now - last, 4 / _STEPS_PER_S), now
            if (index := self._step(passed)) is not None:
                self._on_frame(index)

    def _step(self, passed: float) -> int | None:
        """The frame that has come; None while it is still the last one."""
        with self._lock:
            self._elapsed += self._speed * passed
            if self._elapsed > self.duration + self._speed / _STEPS_PER_S:
                self._elapsed = 0.0
            index = max(int(np.searchsorted(self._times, self._elapsed, side="right")) - 1, 0)
            if index == self._index:
                return None
            self._index = index
            return index
