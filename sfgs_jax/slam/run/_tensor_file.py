"""Named arrays in a safetensors file that is mapped into memory: they are read when they are looked at.

A checksum of the whole file stands among its metadata, so that a changed bit or a missing page is found.
"""

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jax.typing import ArrayLike
from safetensors.numpy import save

from sfgs_jax.arrays import InputError, allow_open_files, excerpt, parsed_json, require_file, write_atomically

_DTYPES = {
    "BOOL": "?",
    "U8": "<u1",
    "I8": "<i1",
    "I16": "<i2",
    "I32": "<i4",
    "I64": "<i8",
    "F32": "<f4",
    "F64": "<f8",
}
_LENGTH_BYTES = 8
_MOST_BYTES = 1 << 40
_KEY = "checksum"
_DIGEST_BYTES = 16
_BLANK = "0" * (2 * _DIGEST_BYTES)
"""In the checksum's place while it is computed."""


def write_tensors(
    path: Path, tensors: Mapping[str, ArrayLike], metadata: Mapping[str, str], *, sync_name: bool = True
) -> None:
    """Write named arrays and text about them; the file is whole or not there.

    Args:
        path: of the file.
        tensors: arrays by name.
        metadata: text by name; the name "checksum" is taken.
        sync_name: as in `write_atomically`.

    Raises:
        OSError: the file can't be written.
    """
    # Not `ascontiguousarray`, which would make a vector of a scalar.
    arrays = {name: np.asarray(array, order="C") for name, array in tensors.items()}
    content = save(arrays, metadata={**metadata, _KEY: _BLANK})
    content = content.replace(_entry(_BLANK), _entry(_digest(content).hexdigest()), 1)
    write_atomically(path, content, sync_name=sync_name)


def read_tensors(path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The arrays of a file by name, mapped into memory, and its metadata.

    Args:
        path: of the file.

    Raises:
        InputError: the file is missing, or is not as it was written.
    """
    try:
        require_file(Path(path), _MOST_BYTES)
        allow_open_files()
        content = np.memmap(path, np.uint8, mode="r")
        start = _LENGTH_BYTES + int.from_bytes(content[:_LENGTH_BYTES].tobytes(), "little")
        if start > len(content):
            raise ValueError("it is cut off")
        head = content[:start].tobytes()
        header = parsed_json(head[_LENGTH_BYTES:])
        metadata = header.pop("__metadata__")
        found = metadata.pop(_KEY)
        digest = _digest(head.replace(_entry(found), _entry(_BLANK), 1))
        digest.update(content[start:].data)
        if digest.hexdigest() != found:
            raise ValueError("its content is not what its checksum says")
        data = content[start:]
        return {name: _array(data, entry) for name, entry in header.items()}, metadata
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{path} can't be read as a saved state ({excerpt(error)}): it is damaged or of another version."
        ) from None


def _entry(digest: str) -> bytes:
    """The checksum's place among the metadata, whose quotes can't be part of another text."""
    return f'"{_KEY}":"{digest}"'.encode()


def _digest(content: bytes) -> "hashlib.blake2b":
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES)


def _array(data: np.ndarray, entry: dict) -> np.ndarray:
    dtype, shape = np.dtype(_DTYPES[entry["dtype"]]), tuple(entry["shape"])
    start, end = entry["data_offsets"]
    if end - start != dtype.itemsize * math.prod(shape):
        raise ValueError("an array has another size than its shape")
    return data[start:end].view(dtype).reshape(shape)
