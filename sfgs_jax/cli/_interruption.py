"""A polite kill ends a command as Ctrl-C does, and neither is lost."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_AGAIN_S = 0.05
"""Seconds until an interruption that was lost is sent again."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt in the main thread for SIGTERM too, until it gets through.

    Python prints and forgets an exception that one of its callbacks raises. JAX has a callback that runs with
    each collection of garbage. An interruption that meets one is sent again.
    """
    unraisable, waiting = sys.unraisablehook, list[threading.Timer]()

    def not_lost(lost: "sys.UnraisableHookArgs") -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            unraisable(lost)
            return
        # Raised here it would be lost as well.
        again = threading.Timer(_AGAIN_S, _interrupt_main_thread)
        again.daemon = True
        waiting.append(again)
        again.start()

    before = signal.signal(signal.SIGTERM, _terminate)
    sys.unraisablehook = not_lost
    try:
        yield
    finally:
        # After the command nobody would catch it, and the process would be killed.
        for again in waiting:
            again.cancel()
        sys.unraisablehook = unraisable
        signal.signal(signal.SIGTERM, before)


def _interrupt_main_thread() -> None:
    if hasattr(signal, "pthread_kill"):
        # Also out of a wait.
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:
        signal.raise_signal(signal.SIGTERM)


def _terminate(signum: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt
