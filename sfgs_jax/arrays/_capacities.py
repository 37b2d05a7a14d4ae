"""Capacities: lists of any length in arrays of few sizes, so that a list that grows compiles few programs."""

from typing import overload

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array


def rounded_up(count: int, multiple: int) -> int:
    """Least multiple of `multiple` that is not below `count`."""
    return -(-count // multiple) * multiple


def bucket(count: int, *, steps: int, smallest: int = 0, multiple: int = 1) -> int:
    """Geometric bucket: the least size 2^k (1 + i / steps), or 0, that is not below `count`.

    Two steps an octave give 1, 1.5, 2, 3, 4, 6, ... and waste a fifth of the room on average. Eight waste a
    twentieth, for four times as many programs.

    Args:
        count: rows that need room.
        steps: sizes from one power of two to the next, a power of two.
        smallest: least size.
        multiple: all sizes are multiples of it, a power of two.
    """
    count = max(count, smallest)
    octave = 1 << max(count.bit_length() - 1, 0)
    return rounded_up(count, max(octave // steps, multiple))


def doubled(capacity: int, need: int) -> int:
    """A capacity of at least 1, doubled until it holds `need`."""
    while capacity < need:
        capacity *= 2
    return capacity


@overload
def padded(rows: Array) -> Array: ...
@overload
def padded(rows: np.ndarray) -> np.ndarray: ...
@overload
def padded(rows: Array | np.ndarray) -> Array | np.ndarray: ...
def padded(rows: Array | np.ndarray) -> Array | np.ndarray:
    """Rows with zeros up to the next of four sizes an octave: clouds of about one size share a program.

    NumPy's rows are padded on the host, without a program for each size.
    """
    room = bucket(rows.shape[0], steps=4, smallest=8, multiple=8)
    pad = np.pad if isinstance(rows, np.ndarray) else jnp.pad
    return pad(rows, [(0, room - rows.shape[0]), *[(0, 0)] * (rows.ndim - 1)])
