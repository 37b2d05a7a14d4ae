"""Files that are either whole or not there."""

import os
import tempfile
from pathlib import Path


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
        os.unlink(name)
        raise
