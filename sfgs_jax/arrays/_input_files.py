"""Content of files that somebody else made: of regular ones, no larger than such files are.

A pipe would wait for ever, and a device has no end. A file with a hole may say that it has a terabyte.
"""

import os
import stat
from pathlib import Path

_MOST_BYTES = 1 << 32
_MOST_TEXT_BYTES = 1 << 29


_LONGEST_PATH, _LONGEST_NAME = 4096, 255
"""Bytes, of every usual file system."""


def can_be_path(path: Path | str) -> bool:
    """Whether a file system can have such a path: JSON can write half of a character, and zeros.

    Args:
        path: of a file or a folder, which need not exist.
    """
    try:
        name = os.fsencode(path)
    except UnicodeEncodeError:
        return False
    short = 0 < len(name) < _LONGEST_PATH and max(map(len, name.split(b"/"))) <= _LONGEST_NAME
    return short and b"\0" not in name


def require_file(path: Path, most: int = _MOST_BYTES) -> int:
    """Size of a regular file, in bytes.

    Args:
        path: of the file; symbolic links are followed.
        most: largest size.

    Raises:
        OSError: there is no such file.
        ValueError: it is a folder, a pipe or a device, or too large.
    """
    found = path.stat()
    if not stat.S_ISREG(found.st_mode):
        raise ValueError("it is no regular file")
    if found.st_size > most:
        raise ValueError(f"it has {found.st_size} bytes, more than it can need")
    return found.st_size


def file_bytes(path: Path | str, most: int = _MOST_BYTES) -> bytes:
    """The bytes of a regular file.

    Args:
        path: of the file.
        most: largest size, bytes.

    Raises:
        OSError: the file can't be read.
        ValueError: it is no regular file, or too large.
    """
    path = Path(path)
    size = require_file(path, most)
    try:
        with path.open("rb") as file:
            # Files of the kernel say that they are empty, and one of them waits for ever.
            return file.read(size)
    except MemoryError:
        raise ValueError(f"it has {size} bytes, more than there is memory") from None


def file_text(path: Path | str) -> str:
    """The text of a regular file, in UTF-8 with or without a byte-order mark; each line ends in a newline.

    Args:
        path: of the file.

    Raises:
        OSError: the file can't be read.
        ValueError: it is no regular file, too large, or no text in UTF-8.
    """
    text = file_bytes(path, _MOST_TEXT_BYTES).decode("utf-8-sig")
    return text.replace("\r\n", "\n").replace("\r", "\n")
