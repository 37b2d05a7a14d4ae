"""Frames that are kept for the evaluation of maps."""

from sfgs_jax.arrays import checked

HELD_OUT_EVERY = 8
"""Frames from one that no map is made from to the next."""


@checked
def is_held_out(number: int) -> bool:
    """Whether a frame is kept for the evaluation: the fifth of every eight.

    Args:
        number: of the frame in its recording, from 0.
    """
    return number % HELD_OUT_EVERY == HELD_OUT_EVERY // 2
