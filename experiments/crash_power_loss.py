"""Loss of power: content and names that were not forced to the disk are lost or torn.

An `fsync` of a file keeps its content, one of a folder the names in it.
Everything else may reach the disk or not: each change of names by itself, each file up to any byte.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from random import Random
from types import TracebackType
from typing import Any, NamedTuple
from unittest import mock

from experiments.crash_faults import FileAround


class _Change(NamedTuple):
    """A change of a file system: `kind` is make, write, sync, replace, remove or folder."""

    kind: str
    path: Path
    content: bytes = b""
    target: Path | None = None


class RecordedDisk:
    """Records what happens to the files in a folder while it is entered.

    Args:
        folder: a folder that is there. Its content at that time is on the disk.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()
        self._before = {path: path.read_bytes() for path in self._folder.rglob("*") if path.is_file()}
        self._changes: list[_Change] = []
        self._handles: dict[int, Path] = {}
        self._patches = ExitStack()

    def __len__(self) -> int:
        """Changes so far."""
        return len(self._changes)

    def __enter__(self) -> "RecordedDisk":
        """Listen to the calls of the operating system."""
        hear: dict[str, Callable[..., None]] = {
            "replace": lambda done, a, b, **_: self._add("replace", a, target=self._path(b)),
            "unlink": lambda done, path, dir_fd=None: self._add("remove", self._path(path, dir_fd)),
            "rmdir": lambda done, path, dir_fd=None: self._add("remove", self._path(path, dir_fd)),
            "mkdir": lambda done, path, mode=0, dir_fd=None: self._add("folder", self._path(path, dir_fd)),
            "open": self._opened,
            "fsync": lambda done, handle: self._add("sync", self._handles.get(handle)),
        }
        for name, told in hear.items():
            self._patches.enter_context(mock.patch.object(os, name, _heard(getattr(os, name), told)))
        opened = os.fdopen
        patch = mock.patch.object(os, "fdopen", lambda *words: _Heard(opened(*words), self._written))
        self._patches.enter_context(patch)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Listen no more."""
        self._patches.close()

    def losses(self, at: int, random: Random, *, count: int) -> Iterator[dict[Path, bytes]]:
        """Files that may be found after the power was lost.

        Args:
            at: changes before that.
            random: chooses what is lost.
            count: of the choices, besides these three: all is lost that can be lost; only new names are
                kept, without content; nothing is lost.

        Yields:
            Contents by paths within the folder.
        """
        disk = _Disk(self._before)
        for change in self._changes[:at]:
            disk.apply(change)
        yield self._within(disk.after_loss(lambda: False, lambda pending: b""))
        yield self._within(disk.after_loss(lambda: True, lambda pending: b""))
        yield self._within(disk.after_loss(lambda: True, lambda pending: pending))
        for _ in range(count):
            yield self._within(disk.after_loss(lambda: random.random() < 0.5, lambda p: _torn(p, random)))

    def _within(self, files: dict[Path, bytes]) -> dict[Path, bytes]:
        return {path.relative_to(self._folder): content for path, content in files.items()}

    def _opened(
        self, handle: int, path: Any, flags: int, mode: int = 0, *, dir_fd: int | None = None
    ) -> None:
        found = self._path(path, dir_fd)
        self._handles[handle] = found
        if flags & os.O_CREAT:
            self._add("make", found)

    def _written(self, handle: int, content: bytes) -> None:
        self._add("write", self._handles.get(handle), bytes(content))

    def _path(self, path: Any, dir_fd: int | None = None) -> Path:
        return Path(os.path.abspath(self._handles[dir_fd] / path if dir_fd is not None else path))

    def _add(self, kind: str, path: Any, content: bytes = b"", target: Path | None = None) -> None:
        if path is None:
            return
        path = self._path(path)
        if path == self._folder or self._folder in path.parents:
            self._changes.append(_Change(kind, path, content, target))


def _heard(function: Callable, told: Callable[..., None]) -> Callable:
    def call(*words: Any, **options: Any) -> Any:
        done = function(*words, **options)
        told(done, *words, **options)
        return done

    return call


def _torn(pending: bytes, random: Random) -> bytes:
    """A beginning of what was written, with or without zeros in place of the rest."""
    kept = pending[: random.randint(0, len(pending))]
    return kept if random.random() < 0.5 else kept.ljust(len(pending), b"\0")


class _Content:
    """A file or a folder: content on the disk, and content on its way to it."""

    def __init__(self, synced: bytes = b"", *, is_folder: bool = False) -> None:
        self.synced, self.pending, self.is_folder = synced, b"", is_folder


class _Disk:
    """Names in folders, and what they are names of; those on the disk, and changes on their way to it."""

    def __init__(self, files: dict[Path, bytes]) -> None:
        self._names = {path: _Content(content) for path, content in files.items()}
        for path in files:
            self._names |= {parent: _Content(is_folder=True) for parent in path.parents}
        self._synced = dict(self._names)
        self._folders = {path for path, content in self._names.items() if content.is_folder}
        self._pending: list[dict[Path, _Content | None]] = []
        """Each change of names, which reaches the disk as a whole or not at all."""

    def apply(self, change: _Change) -> None:
        """Carry out a change."""
        path = change.path
        if change.kind in ("make", "folder"):
            self._name({path: _Content(is_folder=change.kind == "folder")})
            self._folders |= {path} if change.kind == "folder" else set()
        elif change.kind == "write":
            self._names[path].pending += change.content
        elif change.kind == "replace" and change.target is not None:
            self._name({change.target: self._names[path], path: None})
        elif change.kind == "remove":
            self._name({path: None})
        elif change.kind == "sync":
            self._sync(path)

    def _name(self, names: dict[Path, _Content | None]) -> None:
        self._names = _renamed(self._names, names)
        self._pending.append(names)

    def _sync(self, path: Path) -> None:
        content = self._names.get(path)
        if content is not None and not content.is_folder:
            content.synced, content.pending = content.synced + content.pending, b""
            return
        for names in [each for each in self._pending if next(iter(each)).parent == path]:
            self._synced = _renamed(self._synced, names)
            self._pending.remove(names)

    def after_loss(self, is_kept: Callable[[], bool], kept: Callable[[bytes], bytes]) -> dict[Path, bytes]:
        """Files on the disk after a loss.

        Args:
            is_kept: whether the next change of names has reached the disk.
            kept: what has reached the disk of content that was on its way.
        """
        names = self._synced
        for change in self._pending:
            if is_kept():
                names = _renamed(names, change)
        return {
            path: content.synced + kept(content.pending)
            for path, content in names.items()
            if not content.is_folder and all(p in names for p in path.parents if p in self._folders)
        }


def _renamed(names: dict[Path, _Content], change: dict[Path, _Content | None]) -> dict[Path, _Content]:
    return {path: content for path, content in (names | change).items() if content is not None}


class _Heard(FileAround):
    """A file whose writes are told, with its handle, after they were done."""

    def __init__(self, file: Any, told: Callable[[int, bytes], None]) -> None:
        super().__init__(file)
        self._told = told

    def write(self, content: bytes) -> None:
        """Write."""
        self._file.write(content)
        self._told(self._file.fileno(), content)
