"""Files that a list or a JSON file of a recording names."""

import os
from pathlib import Path
from typing import Any

from sfgs_jax.arrays import InputError, can_be_path, excerpt, parsed_json
from sfgs_jax.datasets.files._pose_files import read_text


def read_json(path: Path) -> dict[str, Any]:
    """The object in a JSON file. Raises InputError if it can't be read or holds something else."""
    try:
        content = parsed_json(read_text(path))
    except ValueError as error:
        raise InputError(f"{path} is not valid JSON ({excerpt(error)}).") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} should hold one JSON object.")
    return content


def listed_file(folder: Path, name: str, source: Path | str) -> Path:
    """Path of a file that a list names.

    Args:
        folder: what names are relative to.
        name: the name in the list.
        source: the list, for messages.

    Symbolic links are followed, since people keep images on another disk; what they lead to must be a file.

    Raises:
        InputError: the name leads outside the folder, is the folder's, or is longer than names can be.
    """
    relative = os.path.normpath(name)
    outside = os.path.isabs(relative) or relative.split(os.sep)[0] in (os.curdir, os.pardir)
    if outside or not can_be_path(relative):
        raise InputError(f"{source} names {excerpt(name)}, which lies outside {folder}, or is no file.")
    return folder / relative
