"""Calls of the operating system that fail: the n-th of a kind, once or from then on, or all in a folder."""

import errno
import os
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from unittest import mock

CALLS = ("open", "write", "fsync", "replace")


class Faults:
    """While it is entered, the n-th call of a kind fails as on a full disk.

    A write that fails has written half.

    Args:
        call: one of `CALLS`.
        n: number of the call that fails, from 1.
        for_ever: whether those after it fail too.

    Attributes:
        count: calls of the kind so far.
        failed: whether one has failed.
    """

    def __init__(self, call: str, n: int, *, for_ever: bool) -> None:
        self.call, self.n, self.for_ever = call, n, for_ever
        self.count, self.failed = 0, False
        self._patches = ExitStack()

    def __enter__(self) -> "Faults":
        """Put the calls of the operating system behind those that may fail."""
        for name in ("open", "fsync", "replace"):
            if name == self.call:
                self._patches.enter_context(mock.patch.object(os, name, self._failing(getattr(os, name))))
        if self.call == "write":
            opened = os.fdopen
            patch = mock.patch.object(os, "fdopen", lambda *words: _File(opened(*words), self._fails))
            self._patches.enter_context(patch)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the faults away."""
        self._patches.close()

    def _fails(self) -> bool:
        self.count += 1
        fails = self.count == self.n or (self.for_ever and self.count > self.n)
        self.failed |= fails
        return fails

    def _failing(self, function: Callable) -> Callable:
        def call(*words: Any, **options: Any) -> Any:
            if self._fails():
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return function(*words, **options)

        return call


class FileAround:
    """A file around another, which does all that is not said otherwise."""

    def __init__(self, file: Any) -> None:
        self._file = file

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


class _File(FileAround):
    """A file whose writes may fail half-way."""

    def __init__(self, file: Any, fails: Callable[[], bool]) -> None:
        super().__init__(file)
        self._fails = fails

    def write(self, content: bytes) -> None:
        """Write all of it, or half of it and fail."""
        fails = self._fails()
        self._file.write(content[: len(content) // 2] if fails else content)
        if fails:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class ReadOnly:
    """While it is entered, nothing in a folder can be made, renamed or removed, as on a read-only disk.

    Args:
        folder: the folder; what is open for writing already can be written.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._patches = ExitStack()

    def __enter__(self) -> "ReadOnly":
        """Put the calls of the operating system behind those that fail."""
        for name in ("open", "replace", "mkdir", "unlink"):
            self._patches.enter_context(mock.patch.object(os, name, self._failing(getattr(os, name))))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Let the folder be written again."""
        self._patches.close()

    def _failing(self, function: Callable) -> Callable:
        def call(path: Any, *words: Any, **options: Any) -> Any:
            reads = function.__name__ == "open" and not words[0] & (os.O_CREAT | os.O_WRONLY | os.O_RDWR)
            if not reads and self._folder in Path(os.path.abspath(path)).parents:
                raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(path))
            return function(path, *words, **options)

        return call
