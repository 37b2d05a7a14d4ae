"""Work that waits until its cause rests, in a thread of its own."""

import logging
import threading
import time
from collections.abc import Callable

_logger = logging.getLogger(__name__)


class Latest:
    """Runs the newest call of each name, one after the other, once no newer one has come for a while.

    A slider sends a value for every pixel that it is dragged. The map is sent again once, for the last one.

    Args:
        name: of the thread.
    """

    def __init__(self, name: str) -> None:
        self._condition = threading.Condition()
        self._waiting: dict[str, tuple[float, Callable[[], None]]] = {}
        self._busy = False
        self._closed = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def call(self, name: str, function: Callable[[], None], *, rest_s: float = 0.0) -> None:
        """Run a function later; it takes the place of one of the same name that still waits.

        Args:
            name: of the work.
            function: to run in the thread.
            rest_s: time that has to pass without a newer call, seconds.
        """
        with self._condition:
            self._waiting[name] = (time.monotonic() + rest_s, function)
            self._condition.notify_all()

    def wait(self, timeout_s: float) -> bool:
        """Wait until nothing is left to do; tells whether that came in time."""
        with self._condition:
            return self._condition.wait_for(lambda: not self._waiting and not self._busy, timeout_s)

    def close(self) -> None:
        """Drop what waits, and end once the running function has returned."""
        with self._condition:
            self._closed = True
            self._waiting.clear()
            self._condition.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def _work(self) -> None:
        while (function := self._next()) is not None:
            try:
                function()
            except Exception:
                # The page goes on: one picture less is better than a dead viewer.
                _logger.exception("The viewer could not finish its work.")
            with self._condition:
                self._busy = False
                self._condition.notify_all()

    def _next(self) -> Callable[[], None] | None:
        """The function that is due; waits for one, and returns None at the end."""
        with self._condition:
            while not self._closed:
                name = min(self._waiting, key=lambda key: self._waiting[key][0], default=None)
                left = None if name is None else self._waiting[name][0] - time.monotonic()
                if name is not None and left is not None and left <= 0:
                    self._busy = True
                    return self._waiting.pop(name)[1]
                self._condition.wait(left)
            return None
