"""Recordings of a state: runs that were merged keep their frames apart by number.

Time stamps and numbers of two recordings may be the same. So the frames of another recording are numbered on
from the next multiple of ten million, and keep their time stamps.
"""

import numpy as np
from jaxtyping import Int

from sfgs_jax.geometry import HELD_OUT_EVERY
from sfgs_jax.slam.state._frame_log import FrameLog

_NUMBERS = 1_250_000 * HELD_OUT_EVERY
"""Numbers that a recording has room for: four days of video. Whole cycles, so that the same frames as before
count as held out."""


def shift_of_numbers(newest: int, first: int) -> int:
    """Shift by which the numbers of another recording's frames follow those of the recordings before.

    Args:
        newest: largest number of a frame before.
        first: least number of a frame of the other recording.
    """
    return _NUMBERS * -(-(newest + 1 - first) // _NUMBERS)


def rows_by_recording(log: FrameLog) -> list[Int[np.ndarray, " k"]]:
    """Rows of a log that hold the frames of each recording, the first recording first.

    Args:
        log: of the tracked frames.
    """
    recordings = log.numbers // _NUMBERS
    return [np.flatnonzero(recordings == number) for number in np.unique(recordings)]
