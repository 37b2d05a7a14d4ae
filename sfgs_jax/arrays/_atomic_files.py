"""Files that are either whole or not there."""

import contextlib
import os
import re
import tempfile
from fnmatch import fnmatchcase
from pathlib import Path

_TEMPORARY = re.compile(r"\.(.+)\.[a-z0-9_]{8}")
"""Names of the temporary files, as `tempfile.mkstemp` makes them."""


def write_atomically(path: Path | str, content: bytes | str) -> None:
    """Write `content` so that `path` never holds half of it, whatever interrupts.

    The content goes to a temporary file in the same folder, which then replaces `path`.

    Raises:
        OSError: the folder can't be written, or the disk is full; `path` is as it was.
    """
    path = Path(path)
    data = content.encode() if isinstance(content, str) else content
    handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, 0o644)
        os.replace(name, path)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


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
