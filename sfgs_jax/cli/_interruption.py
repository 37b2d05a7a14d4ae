"""A polite kill ends a command as Ctrl-C does, and neither is lost."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from sfgs_jax.slam import Progress

_AGAIN_S = 0.05
"""Seconds until an interruption that was lost is sent again."""

_asked = threading.Event()
"""Set once the command has been asked to end."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise KeyboardInterrupt in the main thread for SIGTERM too, until it gets through.

    Python prints and forgets an exception that one of its callbacks raises. JAX has a callback that runs with
    each collection of garbage. An interruption that meets one is sent again. One that compiled code forgets
    is told by `end_if_interrupted`.
    """
    unraisable, waiting = sys.unraisablehook, list[threading.Timer]()
    _asked.clear()

    def not_lost(lost: "sys.UnraisableHookArgs") -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            unraisable(lost)
            return
        # Raised here it would be lost as well.
        again = threading.Timer(_AGAIN_S, _interrupt_main_thread)
        again.daemon = True
        waiting.append(again)
        again.start()

    before = {signum: signal.getsignal(signum) for signum in (signal.SIGTERM, signal.SIGINT)}
    signal.signal(signal.SIGTERM, _interrupt)
    # A shell's background jobs ignore Ctrl-C.
    if before[signal.SIGINT] is signal.default_int_handler:
        signal.signal(signal.SIGINT, _interrupt)
    sys.unraisablehook = not_lost
    try:
        yield
    finally:
        # After the command nobody would catch it, and the process would be killed.
        for again in waiting:
            again.cancel()
        sys.unraisablehook = unraisable
        for signum, handler in before.items():
            signal.signal(signum, handler)


def end_if_interrupted(progress: Progress) -> None:
    """End a run whose interruption was lost; an observer.

    Args:
        progress: of the run.

    Raises:
        KeyboardInterrupt: it was asked to end, and goes on.
    """
    if _asked.is_set():
        raise KeyboardInterrupt


def _interrupt_main_thread() -> None:
    if hasattr(signal, "pthread_kill"):
        # Also out of a wait.
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
    else:
        signal.raise_signal(signal.SIGTERM)


def _interrupt(signum: int, frame: FrameType | None) -> None:
    _asked.set()
    raise KeyboardInterrupt
