"""LZFSE, the compression of Apple's systems, by an optional package."""

import importlib

from sfgs_jax.arrays import FrameError, InputError


def require_lzfse() -> None:
    """Raise InputError if the package that decompresses LZFSE is missing."""
    try:
        importlib.import_module("liblzfse")
    except ImportError as error:
        raise InputError(
            "Depth of Record3D is compressed with LZFSE; pip install 'sfgs-jax[record3d]' to read it."
        ) from error


def decompress_lzfse(data: bytes, name: str) -> bytes:
    """Decompress LZFSE.

    Args:
        data: the compressed bytes.
        name: what to call them in an error.

    Raises:
        FrameError: the data is damaged.
    """
    liblzfse = importlib.import_module("liblzfse")
    try:
        return bytes(liblzfse.decompress(data))
    except (liblzfse.error, ValueError, MemoryError) as error:
        raise FrameError(f"{name} is not compressed with LZFSE or is damaged.") from error
