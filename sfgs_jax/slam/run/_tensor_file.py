"""Named arrays in a safetensors file that is mapped into memory: they are read when they are looked at."""

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from sfgs_jax.arrays import InputError, write_atomically

_DTYPES = {"BOOL": "?", "U8": "<u1", "I32": "<i4", "I64": "<i8", "F32": "<f4", "F64": "<f8"}
_LENGTH_BYTES = 8


def write_tensors(path: Path, tensors: Mapping[str, ArrayLike], metadata: Mapping[str, str]) -> None:
    """Write named arrays and text about them; the file is whole or not there.

    Args:
        path: of the file.
        tensors: arrays by name.
        metadata: text by name.

    Raises:
        OSError: the file can't be written.
    """
    # Not `ascontiguousarray`, which would make a vector of a scalar.
    arrays = {name: np.asarray(array, order="C") for name, array in tensors.items()}
    write_atomically(path, save(arrays, metadata=dict(metadata)))


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays of a file by name, mapped into memory, and its metadata.

    Args:
        path: of the file.

    Raises:
        InputError: the file is missing, damaged or shorter than it says.
    """
    try:
        # Refuses headers that don't fit the file.
        with safe_open(path, framework="numpy") as file:
            metadata = dict(file.metadata() or {})
        with path.open("rb") as raw:
            length = int.from_bytes(raw.read(_LENGTH_BYTES), "little")
            header = json.loads(raw.read(length))
        header.pop("__metadata__", None)
        size = path.stat().st_size - _LENGTH_BYTES - length
        data = (
            np.memmap(path, np.uint8, mode="r", offset=_LENGTH_BYTES + length)
            if size
            else np.zeros(0, np.uint8)
        )
        return {name: _array(data, entry) for name, entry in header.items()}, metadata
    except (OSError, SafetensorError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path} can't be read as a saved state: {error}.") from None


def _array(data: np.ndarray, entry: dict) -> np.ndarray:
    dtype, shape = np.dtype(_DTYPES[entry["dtype"]]), tuple(entry["shape"])
    start, end = entry["data_offsets"]
    if end - start != dtype.itemsize * math.prod(shape):
        raise ValueError("an array has another size than its shape")
    return data[start:end].view(dtype).reshape(shape)
