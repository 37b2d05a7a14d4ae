"""Files that are either whole or not there, also after a loss of power."""

import contextlib
import errno
import os
import re
import tempfile
from fnmatch import fnmatchcase
from pathlib import Path

_TEMPORARY = re.compile(r"\.(.+)\.[a-z0-9_]{8}")
"""Names of the temporary files, as `tempfile.mkstemp` makes them."""
_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.EACCES)
"""Errors of file systems that can't force a folder to the disk, and of folders that can't be read."""


def write_atomically(path: Path | str, content: bytes | str, *, sync_name: bool = True) -> None:
    """Write `content` so that `path` never holds half of it, whatever interrupts.

    The content goes to a temporary file in the same folder, which then replaces `path`.

    Args:
        path: of the file.
        content: bytes, or text in UTF-8.
        sync_name: force the name to the disk too. Otherwise `sync_folder` does it for many files at once.

    Raises:
        OSError: the folder can't be written, or the disk is full; `path` is as it was, or whole. The error
            names `path`.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(data)
            put_in_place(Path(name), path, sync_name=sync_name)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise
    except OSError as error:
        # Nobody knows the temporary file by its name.
        raise OSError(error.errno, error.strerror, str(path)) from error


def put_in_place(temporary: Path, path: Path, *, sync_name: bool = True) -> None:
    """Let a finished temporary file replace `path`; both are forced to the disk, file first, name last.

    Args:
        temporary: the file, in the same folder.
        path: its name from now on; readable for all.
        sync_name: as in `write_atomically`.

    Raises:
        OSError: it can't be forced to the disk or renamed.
    """
    os.chmod(temporary, 0o644)
    _sync(temporary, os.O_RDONLY)
    os.replace(temporary, path)
    if sync_name:
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Force the names in a folder to the disk: a file that is renamed has its new name only after that.

    Args:
        folder: whose files were made, renamed or removed. Some file systems can't do it, which is no error.

    Raises:
        OSError: the disk has failed.
    """
    try:
        _sync(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise


def make_folder(folder: Path, *, private: bool = False) -> None:
    """Make a folder, and those that it lies in, so that a loss of power does not take them away.

    Args:
        folder: may be there already.
        private: nobody else may look into it (mode 0700) if it is made.

    Raises:
        OSError: it can't be made.
    """
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(mode=0o700 if private else 0o777, parents=True, exist_ok=True)
    for each in missing:
        sync_folder(each.parent)


def _sync(path: Path, flags: int) -> None:
    handle = os.open(path, flags)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def remove_unfinished(folder: Path | str, *names: str) -> None:
    """Remove the temporary files that a killed process has left beside the files that it wrote.

    Args:
        folder: where it wrote; one that is not there holds none.
        names: of the files that it wrote, `*` for any characters.

    Raises:
        OSError: a file can't be removed.
    """
    folder = Path(folder)
    for path in folder.iterdir() if folder.is_dir() else ():
        found = _TEMPORARY.fullmatch(path.name)
        if found and any(fnmatchcase(found[1], name) for name in names) and path.is_file():
            path.unlink()
