"""Arrays in one file that can be mapped into memory: they are read when they are looked at."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sfgs_jax.geometry import InputError, write_atomically

_ALIGNMENT = 64


def write_arrays(path: Path, arrays: Sequence[Any], **facts: Any) -> None:
    """Write arrays, and facts about them that JSON can hold; the file is whole or not there."""
    parts, position, entries = [], 0, []
    for array in arrays:
        # Not `ascontiguousarray`, which would make a vector of a scalar.
        values = np.asarray(array, order="C")
        entries.append({"dtype": values.dtype.str, "shape": values.shape, "start": position})
        padding = -values.nbytes % _ALIGNMENT
        parts += [values.tobytes(), bytes(padding)]
        position += values.nbytes + padding
    head = json.dumps({"arrays": entries, "facts": facts}).encode()
    head += b" " * (-(len(head) + 1) % _ALIGNMENT) + b"\n"
    write_atomically(path, b"".join([head, *parts]))


def read_arrays(path: Path) -> tuple[list[np.ndarray], dict[str, Any]]:
    """The arrays of a file, mapped into memory, and the facts.

    Raises:
        InputError: the file is missing, damaged or shorter than it says.
    """
    try:
        with path.open("rb") as file:
            line = file.readline()
        head = json.loads(line)
        data = np.memmap(path, np.uint8, mode="r", offset=len(line)) if head["arrays"] else np.zeros(0)
        arrays = []
        for entry in head["arrays"]:
            dtype, shape = np.dtype(entry["dtype"]), tuple(entry["shape"])
            size = dtype.itemsize * int(np.prod(shape))
            part = data[entry["start"] : entry["start"] + size]
            arrays.append(part.view(dtype).reshape(shape))
        return arrays, head["facts"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} can't be read as a saved state: {error}.") from None
