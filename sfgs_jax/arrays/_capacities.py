"""Capacities: lists of any length in arrays of few sizes, so that a list that grows compiles few programs."""

import jax.numpy as jnp
from jaxtyping import Array, Shaped


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


def padded(rows: Shaped[Array, "n ..."]) -> Shaped[Array, "m ..."]:
    """Rows with zeros up to the next of four sizes an octave: clouds of about one size share a program."""
    room = bucket(rows.shape[0], steps=4, smallest=8, multiple=8)
    return jnp.pad(rows, [(0, room - rows.shape[0]), *[(0, 0)] * (rows.ndim - 1)])
