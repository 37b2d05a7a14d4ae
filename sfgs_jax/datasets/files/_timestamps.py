"""Time stamps of frames, from files' names or a frame rate."""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError


def check_increasing(timestamps: Float[np.ndarray, " n"], source: Path) -> None:
    """Raise InputError unless each frame's time stamp is above the one before it.

    Args:
        timestamps: seconds.
        source: the file that they are from, for the message.
    """
    if not (np.diff(timestamps) > 0).all():
        raise InputError(f"The time stamps in {source} do not increase from frame to frame.")


def is_time(path: Path) -> bool:
    """True if a file's name without its ending is a number with a decimal point, such as a time stamp."""
    return re.fullmatch(r"\d+\.\d+", path.stem) is not None


def times_of_names(paths: Sequence[Path], frames_per_second: float) -> Float[np.ndarray, " n"]:
    """Time stamps from the files' names if all are decimal numbers, else from the frame rate; seconds."""
    if all(map(is_time, paths)):
        return np.asarray([float(path.stem) for path in paths], np.float64)
    return np.arange(len(paths), dtype=np.float64) / frames_per_second
