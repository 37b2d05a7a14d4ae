"""Compilation in the background of programs that will be needed soon."""

from collections.abc import Callable, Hashable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec

_P = ParamSpec("_P")

BACKGROUND_THREAD = "sfgs_jax background"
"""Beginning of the thread's name."""


class Background:
    """A thread that calls functions for the programs which they compile, each for the first time only."""

    def __init__(self) -> None:
        """Without work; the thread begins with the first."""
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=BACKGROUND_THREAD)
        self._asked: set[Hashable] = set()

    def once(
        self, key: Hashable, function: Callable[_P, object], *args: _P.args, **kwargs: _P.kwargs
    ) -> Future[object] | None:
        """Call a function in the background, unless something was called for the same key before.

        Args:
            key: what the programs depend on: capacities, settings.
            function: to call.
            *args: of the function.
            **kwargs: of the function.

        Returns:
            Done when it has been called; None if it is not called again.
        """
        if key in self._asked:
            return None
        self._asked.add(key)
        return self._thread.submit(function, *args, **kwargs)
