"""Containers of SPZ: one gzip stream in version 3, a table and zstd frames in version 4.

Source: github.com/nianticlabs/spz, the format's description.
"""

import gzip
import itertools
import struct
import sys
import zlib
from collections.abc import Sequence
from typing import Literal, NamedTuple

from sfgs_jax.arrays import InputError, excerpt
from sfgs_jax.splatting.files._spz_streams import COEFFICIENTS, stream_sizes

Version = Literal[3, 4]

MOST_GAUSSIANS = 10_000_000
"""The format's reference reader refuses more."""

_MAGIC = 0x5053474E  # the bytes NGSP
_GZIP_MAGIC = b"\x1f\x8b"
_COMMON = struct.Struct("<IIIBBBB")
"""Magic, version, Gaussians, degree, fractional bits, flags, streams. Version 3 ends here, with 0 streams."""
_TABLE_PLACE = struct.Struct("<I12x")
"""The rest of version 4's header: where the table begins."""
_TABLE_ROW = struct.Struct("<QQ")
"""Bytes of a stream, compressed and raw."""
_HAS_EXTENSIONS = 0x2


class Header(NamedTuple):
    """Number of Gaussians, coefficients a channel of their harmonics, bits after the point of positions."""

    num_gaussians: int
    coefficients: int
    bits: int


def packed(header: Header, streams: Sequence[bytes], version: Version) -> bytes:
    """Content of a file.

    Raises:
        InputError: version 4 is asked for and no zstd is installed.
    """
    degree = COEFFICIENTS.index(header.coefficients)
    if version == 3:
        common = _COMMON.pack(_MAGIC, 3, header.num_gaussians, degree, header.bits, 0, 0)
        return gzip.compress(common + b"".join(streams), mtime=0)
    zstd = _zstd()
    filled = [stream for stream in streams if stream]
    frames = [zstd.compress(stream) for stream in filled]
    parts = [
        _COMMON.pack(_MAGIC, 4, header.num_gaussians, degree, header.bits, 0, len(filled)),
        _TABLE_PLACE.pack(_COMMON.size + _TABLE_PLACE.size),
        *(_TABLE_ROW.pack(len(frame), len(raw)) for frame, raw in zip(frames, filled, strict=True)),
    ]
    return b"".join([*parts, *frames])


def unpacked(content: bytes) -> tuple[Header, list[bytes]]:
    """Header and raw streams of a file; no more room is made than its header promises.

    Raises:
        ValueError: the content is no SPZ file of version 3 or 4, or is damaged.
        InputError: it has version 4 and no zstd is installed.
    """
    if content[:2] == _GZIP_MAGIC:
        return _unpacked_gzip(content)
    return _unpacked_zstd(content)


def _unpacked_gzip(content: bytes) -> tuple[Header, list[bytes]]:
    stream = zlib.decompressobj(wbits=16 + zlib.MAX_WBITS)
    try:
        header, _ = _header(stream.decompress(content, _COMMON.size), version=3)
        sizes = stream_sizes(header.num_gaussians, header.coefficients)
        body = stream.decompress(stream.unconsumed_tail, sum(sizes) + 1)
    except zlib.error as error:
        raise ValueError(f"its gzip stream is damaged ({excerpt(error)})") from error
    if len(body) != sum(sizes) or not stream.eof:
        raise ValueError(f"it should hold {sum(sizes)} bytes for its {header.num_gaussians} Gaussians")
    ends = list(itertools.accumulate(sizes, initial=0))
    return header, [body[start:end] for start, end in itertools.pairwise(ends)]


def _unpacked_zstd(content: bytes) -> tuple[Header, list[bytes]]:
    header, num_streams = _header(content, version=4)
    sizes = stream_sizes(header.num_gaussians, header.coefficients)
    filled = [size for size in sizes if size]
    if num_streams != len(filled) or len(content) < _COMMON.size + _TABLE_PLACE.size:
        raise ValueError(f"it should have {len(filled)} streams")
    (place,) = _TABLE_PLACE.unpack_from(content, _COMMON.size)
    end = place + num_streams * _TABLE_ROW.size
    rows = list(_TABLE_ROW.iter_unpack(content[place:end])) if end <= len(content) else []
    if [raw for _, raw in rows] != filled or end + sum(size for size, _ in rows) != len(content):
        raise ValueError("its table does not agree with its streams")
    ends = itertools.accumulate((size for size, _ in rows), initial=end)
    frames = [content[start:stop] for start, stop in itertools.pairwise(ends)]
    raw = iter([_decompressed(frame, size) for frame, size in zip(frames, filled, strict=True)])
    return header, [next(raw) if size else b"" for size in sizes]


def _header(content: bytes, version: Version) -> tuple[Header, int]:
    """The header and the number of streams."""
    if len(content) < _COMMON.size:
        raise ValueError("it has no header")
    magic, found, count, degree, bits, flags, num_streams = _COMMON.unpack_from(content)
    if magic != _MAGIC:
        raise ValueError("it does not begin as one")
    if found != version:
        raise ValueError(f"it has version {found}; versions 3 and 4 are read")
    if count > MOST_GAUSSIANS or degree >= len(COEFFICIENTS) or bits > 23:
        raise ValueError(f"{count} Gaussians of degree {degree} with {bits} fractional bits are too much")
    if flags & _HAS_EXTENSIONS:
        raise ValueError("it has extensions, which are not read")
    return Header(count, COEFFICIENTS[degree], bits), num_streams


def _decompressed(frame: bytes, size: int) -> bytes:
    zstd = _zstd()
    decompressor = zstd.ZstdDecompressor()
    try:
        raw = decompressor.decompress(frame, size + 1)
    except zstd.ZstdError as error:
        raise ValueError(f"a stream is damaged ({excerpt(error)})") from error
    if len(raw) != size or not decompressor.eof:
        raise ValueError("a stream has another size than the table says")
    return raw


def _zstd():
    """The module of the standard library, or its backport."""
    try:
        if sys.version_info >= (3, 14):
            from compression import zstd
        else:
            from backports import zstd
    except ImportError:
        raise InputError("SPZ of version 4 needs zstd: pip install 'sfgs-jax[spz4]'.") from None
    return zstd
