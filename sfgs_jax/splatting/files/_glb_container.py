"""The container of binary glTF: a description in JSON and one block of data."""

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from sfgs_jax.arrays import InputError, file_bytes, parsed_json

_HEADER, _CHUNK = struct.Struct("<4sII"), struct.Struct("<I4s")


def packed_glb(description: Mapping[str, object], data: bytes) -> bytes:
    """The container: a header, then the description and the data as chunks of whole words.

    Args:
        description: of scenes, meshes and accessors.
        data: of its only buffer, whole words.

    Raises:
        InputError: the file would exceed 4 GB.
    """
    text = json.dumps(description, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = _HEADER.size + 2 * _CHUNK.size + len(text) + len(data)
    if length >= 2**32:
        raise InputError(f"The file would have {length / 1e9:.1f} GB; glTF ends at 4 GB. Use another format.")
    return b"".join(
        [
            _HEADER.pack(b"glTF", 2, length),
            _CHUNK.pack(len(text), b"JSON"),
            text,
            _CHUNK.pack(len(data), b"BIN\0"),
            data,
        ]
    )


def unpacked_glb(path: Path) -> tuple[dict[str, Any], bytes]:
    """Description and data of a file; no data is b"".

    Args:
        path: the file.

    Raises:
        InputError: there is no such file, or it is no binary glTF 2.0, or is cut off.
    """
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    try:
        content = file_bytes(path)
        magic, version, length = _HEADER.unpack_from(content)
        size, kind = _CHUNK.unpack_from(content, _HEADER.size)
        if magic != b"glTF" or version != 2 or kind != b"JSON" or length != len(content):
            raise ValueError
        start = _HEADER.size + _CHUNK.size
        description = parsed_json(content[start : start + size])
        if not isinstance(description, dict):
            raise ValueError
        data = b""
        if start + size < length:
            width, kind = _CHUNK.unpack_from(content, start + size)
            data = content[start + size + _CHUNK.size :][:width]
            if kind != b"BIN\0" or len(data) < width:
                raise ValueError
    except (OSError, struct.error, ValueError) as error:
        raise InputError(f"{path} is no binary glTF 2.0 file, or is damaged.") from error
    return description, data
