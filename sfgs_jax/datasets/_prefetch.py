"""Prefetching: frames are decoded in a thread ahead of the consumer."""

import queue
import threading
from collections.abc import Generator

from sfgs_jax.arrays import FrameError, checked, require_least
from sfgs_jax.datasets._recording import Recording
from sfgs_jax.geometry import Frame


@checked
def prefetch(
    recording: Recording, *, ahead: int = 4, first: int = 0
) -> Generator[tuple[int, Frame | FrameError], None, None]:
    """Frames of a recording in order, decoded up to `ahead` frames before they are asked for.

    A frame that can't be used is yielded as its `FrameError`. Any other exception is raised in the
    consumer, after the frames before it. The thread ends with the iterator, also if that is closed or
    dropped early.

    Args:
        recording: source of the frames.
        ahead: most frames that wait decoded, at least 1.
        first: index of the first frame.

    Yields:
        The frame's index, and the frame or the error that kept it from being decoded.

    Raises:
        InputError: no frame may wait, or the first index is negative.
    """
    require_least(ahead, 1, "ahead of prefetch")
    require_least(first, 0, "first of prefetch")
    # A bounded queue alone would leave the thread blocked in `put` once nobody takes any more.
    waiting: queue.Queue[tuple[int, Frame | BaseException] | None] = queue.Queue(maxsize=ahead)
    stopped = threading.Event()

    def put(item: tuple[int, Frame | BaseException] | None) -> None:
        while not stopped.is_set():
            try:
                return waiting.put(item, timeout=0.1)
            except queue.Full:
                continue

    def decode() -> None:
        for index in range(first, len(recording)):
            if stopped.is_set():
                return
            try:
                put((index, recording[index]))
            except FrameError as error:
                put((index, error))
            except BaseException as error:
                put((index, error))
                return
        put(None)

    thread = threading.Thread(target=decode, name="prefetch", daemon=True)
    thread.start()
    try:
        while (item := waiting.get()) is not None:
            index, frame = item
            if isinstance(frame, BaseException) and not isinstance(frame, FrameError):
                raise frame
            yield index, frame
    finally:
        stopped.set()
        thread.join()
