"""Decoding ahead: order, errors, and threads that end."""

import threading
import time

import numpy as np
import pytest

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import prefetch
from sfgs_jax.geometry import Camera, Frame


class Scripted:
    """A recording that counts what was asked of it and fails where told to."""

    name, dataset, notes, ground_truth = "scripted", "folder", (), None
    camera = Camera(1.0, 1.0, 0.0, 0.0, width=2, height=1)

    def __init__(self, length: int, errors: dict[int, Exception] | None = None):
        self.timestamps = np.arange(length, dtype=np.float64)
        self.errors = errors or {}
        self.asked: list[int] = []

    def __len__(self) -> int:
        return len(self.timestamps)

    def __getitem__(self, index: int) -> Frame:
        self.asked.append(index)
        if index in self.errors:
            raise self.errors[index]
        return Frame(np.zeros((1, 2, 3), np.float32), np.ones((1, 2), np.float32), float(index))


def _prefetch_threads() -> list[threading.Thread]:
    return [thread for thread in threading.enumerate() if thread.name == "prefetch"]


def test_every_frame_in_order():
    got = list(prefetch(Scripted(20), ahead=3))
    assert [index for index, _ in got] == list(range(20))
    assert [frame.timestamp for _, frame in got if isinstance(frame, Frame)] == list(range(20))
    assert not _prefetch_threads()


def test_bad_frames_are_yielded_and_the_rest_goes_on():
    error = FrameError("frame 1 is truncated.")
    got = list(prefetch(Scripted(3, {1: error})))
    assert [index for index, _ in got] == [0, 1, 2]
    assert got[1][1] is error
    assert isinstance(got[2][1], Frame)


def test_other_errors_are_raised_after_the_frames_before_them():
    frames = prefetch(Scripted(5, {2: MemoryError("no memory")}))
    assert [next(frames)[0], next(frames)[0]] == [0, 1]
    with pytest.raises(MemoryError, match="no memory"):
        next(frames)
    assert not _prefetch_threads()


def test_only_a_few_frames_are_decoded_ahead():
    recording = Scripted(100)
    frames = prefetch(recording, ahead=2)
    next(frames)
    time.sleep(0.1)  # enough for the thread to decode all of them if nothing held it
    # One taken, two in the queue, one waiting to be put.
    assert len(recording.asked) <= 4
    frames.close()


@pytest.mark.parametrize("how", ["close", "drop", "raise"])
def test_thread_ends_when_the_consumer_stops(how):
    frames = prefetch(Scripted(100), ahead=1)
    next(frames)
    assert len(_prefetch_threads()) == 1
    if how == "close":
        frames.close()
    elif how == "drop":
        del frames
    else:
        with pytest.raises(KeyboardInterrupt):
            frames.throw(KeyboardInterrupt())
    assert not _prefetch_threads()


def test_nothing_starts_before_the_first_frame_is_asked_for():
    recording = Scripted(3)
    frames = prefetch(recording)
    assert not recording.asked
    del frames
