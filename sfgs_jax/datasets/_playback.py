"""Playback of a recording by its own clock, as a camera would deliver it."""

import threading
import time
from collections.abc import Iterator

import numpy as np

from sfgs_jax.arrays import FrameError, checked, require_least
from sfgs_jax.datasets._recording import Recording
from sfgs_jax.geometry import LONGEST_BREAK_S, Frame


@checked
def play(recording: Recording, *, first: int = 0) -> Iterator[tuple[int, Frame | FrameError]]:
    """Frames of a recording at the times they were taken; a consumer that is too slow misses frames.

    A thread decodes the newest frame that is due and leaves it for the consumer. The next frame replaces one
    that was not taken, so a slow consumer gets fewer frames, not older ones. The clock starts with the first
    frame asked for. A break of more than an hour is not waited for: one of the two stamps must be wrong.

    Args:
        recording: source of the frames.
        first: index of the first frame.

    Yields:
        The frame's index, and the frame or the error that kept it from being decoded.

    Raises:
        InputError: the first index is negative.
    """
    require_least(first, 0, "first of play")
    mailbox = _Mailbox()
    steps = np.diff(recording.timestamps, prepend=recording.timestamps[:1])
    steps[: first + 1] = 0.0
    times = np.cumsum(np.where(steps > LONGEST_BREAK_S, 0.0, steps))

    def decode() -> None:
        start = time.monotonic()
        try:
            for index in range(first, len(recording)):
                now = time.monotonic() - start
                last = index + 1 == len(recording)
                if not last and times[index + 1] <= now:
                    continue
                if mailbox.closed.wait(max(0.0, times[index] - now)):
                    return
                try:
                    mailbox.put((index, recording[index]))
                except FrameError as error:
                    mailbox.put((index, error))
            mailbox.finish(None)
        except BaseException as error:
            mailbox.finish(error)

    thread = threading.Thread(target=decode, name="play", daemon=True)
    thread.start()
    try:
        while (item := mailbox.take()) is not None:
            yield item
    finally:
        mailbox.closed.set()
        thread.join()


class _Mailbox:
    """Holds the newest frame only."""

    def __init__(self) -> None:
        self.closed = threading.Event()
        self._changed = threading.Condition()
        self._item: tuple[int, Frame | FrameError] | None = None
        self._finished = False
        self._failure: BaseException | None = None

    def put(self, item: tuple[int, Frame | FrameError]) -> None:
        with self._changed:
            self._item = item
            self._changed.notify()

    def finish(self, failure: BaseException | None) -> None:
        with self._changed:
            self._finished, self._failure = True, failure
            self._changed.notify()

    def take(self) -> tuple[int, Frame | FrameError] | None:
        """Wait for a frame; None after the last. Raises the error that ended the thread."""
        with self._changed:
            self._changed.wait_for(lambda: self._item is not None or self._finished)
            item, self._item = self._item, None
            if item is None and self._failure is not None:
                raise self._failure
            return item
