"""A lock on an output folder, so that two runs do not write into it at once."""

import errno
import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sfgs_jax.arrays import InputError, checked, make_folder


@checked
@contextmanager
def locked_folder(folder: Path, *, make: bool = True) -> Iterator[None]:
    """Hold the folder for this process alone.

    The lock (`flock`) is on the folder itself, so no file stays behind, and it ends with the process, however
    that ends. File systems without locks give none.

    Args:
        folder: to write to.
        make: make it if it is not there; otherwise a folder that is not there is not locked.

    Raises:
        InputError: another run holds it, or it can't be made.
    """
    try:
        if make:
            make_folder(folder)
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY) if folder.is_dir() else None
    except OSError as error:
        raise InputError(
            f"The output folder {folder} cannot be written ({error.strerror}): choose another with --out."
        ) from error
    if handle is None:
        yield
        return
    try:
        _lock(handle, folder)
        yield
    finally:
        os.close(handle)


def _lock(handle: int, folder: Path) -> None:
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in (errno.EWOULDBLOCK, errno.EACCES):
            return
        raise InputError(
            f"Another run writes to {folder}: wait for its end, or choose another folder with --out."
        ) from None
