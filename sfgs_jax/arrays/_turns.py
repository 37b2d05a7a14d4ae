"""Turns of Python's threads: how long one may hold the interpreter while another waits for it.

A compiled program runs without the interpreter, and takes it again afterwards. A thread at work in Python,
one that traces a program say, gives it up only after five milliseconds. A step takes it a hundred times: with
such a thread beside it a frame takes half a second instead of 17 ms.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SECONDS = 1e-4
"""Longest turn. A frame beside a busy thread then takes 40 ms, and that thread loses a fifth of its speed.
With a millisecond it is 110 ms and a tenth."""

PATIENCE = 0.002
"""Seconds after which a frame that is waited for is not there yet, so that other threads may begin."""


@contextmanager
def short_turns() -> Iterator[None]:
    """Let the threads of this process take short turns in the block."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(min(before, _SECONDS))
    try:
        yield
    finally:
        sys.setswitchinterval(before)
