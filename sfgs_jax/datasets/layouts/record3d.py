"""Captures of the app Record3D: an .r3d file, or the folder of an unpacked one.

The archive holds `metadata` (JSON) and, for frame N, rgbd/N.jpg, rgbd/N.depth and rgbd/N.conf. Depth is
float32 in metres and confidence 8 bits, both compressed with LZFSE. Depth is registered to colour, and a
fraction of its size. Quaternions have their real part last. ARKit's cameras have OpenGL's axes.
"""

import lzma
import math
import struct
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from sfgs_jax.arrays import FrameError, InputError, excerpt, file_bytes, parsed_json
from sfgs_jax.datasets._options import ReaderOptions
from sfgs_jax.datasets.files import (
    FilePair,
    FileRecording,
    Intrinsics,
    check_increasing,
    colour_of_bytes,
    common_view,
    confident,
    decompress_lzfse,
    depth_of_array,
    ground_truth_by_frame,
    opencv_poses,
    quaternion_poses,
    read_camera_json,
    require_lzfse,
)

_FRAMES_PER_SECOND = 30.0
# A larger member is damage or an attack, not a picture or metadata of a capture.
_LARGEST_MEMBER = 1 << 28
# No camera has longer sides.
_LONGEST_SIDE = 1 << 14
# Depth of 2000x2000 pixels; phones have 640x480 at most.
_LARGEST_IMAGE = 1 << 24

# Raised by zipfile and its decompressors where an archive is damaged.
_DAMAGE = (
    OSError,
    zipfile.BadZipFile,
    zlib.error,
    lzma.LZMAError,
    RuntimeError,
    EOFError,
    struct.error,
    ValueError,
)


def matches(source: Path) -> bool:
    """True for an .r3d file, and for a folder with metadata and rgbd/."""
    if source.suffix.lower() == ".r3d" and source.is_file():
        return True
    return (source / "metadata").is_file() and (source / "rgbd").is_dir()


def read(source: Path, options: ReaderOptions) -> FileRecording:
    """Open a Record3D capture. Arguments and errors as of `open_recording`."""
    require_lzfse()
    members = _Members(source)
    metadata = _Metadata.read(members)
    intrinsics = read_camera_json(options.camera) if options.camera else metadata.intrinsics
    numbers = [n for n in members.frames if n < len(metadata.timestamps)]
    timestamps = metadata.timestamps[numbers]
    pairs = [
        FilePair(_Colour(members, n), _Depth(members, n, metadata.aspect, options.min_confidence), time)
        for n, time in zip(numbers, timestamps.tolist(), strict=True)
    ]
    view = common_view(source, pairs, options.depth_scale, intrinsics)
    poses = [metadata.poses[n] if n < len(metadata.poses) else None for n in numbers]
    ground_truth, truth_notes = ground_truth_by_frame(poses, timestamps)
    return FileRecording(
        name=source.resolve().stem,
        dataset="record3d",
        camera=view.camera,
        pairs=pairs,
        units_per_metre=options.depth_scale,
        ground_truth=ground_truth,
        notes=(*intrinsics.notes, *view.notes, *truth_notes),
        register=view.register,
    )


class _Members:
    """The files of a capture, in an archive or in a folder."""

    def __init__(self, source: Path) -> None:
        self.source = source
        self._archive = None
        try:
            if source.is_file():
                self._archive = zipfile.ZipFile(source)
                names = self._archive.namelist()
            else:
                names = [f"rgbd/{path.name}" for path in (source / "rgbd").iterdir()]
        except _DAMAGE as error:
            raise InputError(f"{source} cannot be read as an .r3d archive: {excerpt(error)}.") from error
        self.names = frozenset(names)
        stems = [name[5:-4] for name in names if name.startswith("rgbd/") and name.endswith(".jpg")]
        # Beyond a million frames a number is damage.
        self.frames = sorted(int(stem) for stem in stems if stem.isdecimal() and len(stem) <= 6)

    def read(self, name: str, largest: int = _LARGEST_MEMBER) -> bytes:
        """Content of a file of at most `largest` bytes. Raises FrameError if it can't be read."""
        try:
            if self._archive is None:
                return file_bytes(self.source / name, largest)
            size = self._archive.getinfo(name).file_size
            if size > largest:
                raise ValueError(f"it has {size} bytes, more than it can need")
            return self._archive.read(name)
        except KeyError as error:
            raise FrameError(f"{self.text(name)} is missing.") from error
        except _DAMAGE as error:
            raise FrameError(f"{self.text(name)} cannot be read: {excerpt(error)}.") from error

    def text(self, name: str) -> str:
        """Path of a file, for messages."""
        return f"{self.source}/{name}"


@dataclass(frozen=True)
class _Metadata:
    """Intrinsics, times and poses of a capture.

    Attributes:
        intrinsics: of colour.
        aspect: width / height of colour and depth.
        timestamps: (N,) seconds.
        poses: (M, 4, 4) `T_world_cam`, M at most N.
    """

    intrinsics: Intrinsics
    aspect: float
    timestamps: Float[np.ndarray, " n"]
    poses: Float[np.ndarray, "m 4 4"]

    @staticmethod
    def read(members: _Members) -> "_Metadata":
        """Raises InputError if the metadata is missing or lacks something."""
        path = members.text("metadata")
        try:
            content = parsed_json(members.read("metadata"))
            K = _numbers(content["K"], 9)[0]
            width, height = int(content["w"]), int(content["h"])
            poses = _numbers(content.get("poses", []), 7)
            times = _numbers(content.get("frameTimestamps", []), 1)[:, 0]
            fps = float(content.get("fps") or _FRAMES_PER_SECOND)
            if not (min(width, height) > 0 and max(width, height) <= _LONGEST_SIDE and 0 < fps < math.inf):
                raise ValueError(f"w and h must be from 1 to {_LONGEST_SIDE}, and fps above 0")
            if not np.isfinite(times).all():
                raise ValueError("frameTimestamps must be finite")
        except FrameError as error:
            raise InputError(str(error)) from error
        except (OverflowError, KeyError, TypeError, ValueError, IndexError) as error:
            raise InputError(f"{path} does not describe a Record3D capture ({excerpt(error)}).") from error
        check_increasing(times, Path(path))
        if not len(times):
            times = np.arange(max(members.frames, default=-1) + 1) / fps
        return _Metadata(
            # K is stored column by column.
            Intrinsics(K[0], K[4], K[6], K[7], width=width, height=height),
            width / height,
            times,
            opencv_poses(quaternion_poses(poses[:, 4:], poses[:, :4])),
        )


def _numbers(values: Any, count: int) -> Float[np.ndarray, "n k"]:
    """Rows of `count` numbers."""
    return np.asarray(values, np.float64).reshape(-1, count)


@dataclass(frozen=True)
class _Colour:
    """Colour of a frame, a `ColourImage`."""

    members: _Members
    number: int

    def rgb(self) -> Float[np.ndarray, "h w 3"]:
        name = f"rgbd/{self.number}.jpg"
        return colour_of_bytes(self.members.read(name), self.members.text(name))

    def __str__(self) -> str:
        return self.members.text(f"rgbd/{self.number}.jpg")


@dataclass(frozen=True)
class _Depth:
    """Depth of a frame without its pixels of low confidence, a `DepthImage`."""

    members: _Members
    number: int
    aspect: float
    least_confidence: int

    def metres(self, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        name = f"rgbd/{self.number}.depth"
        depth = depth_of_array(self._image(name, np.float32), units_per_metre, str(self))
        name = f"rgbd/{self.number}.conf"
        if name not in self.members.names:
            return depth
        confidence = self._image(name, np.uint8)
        return confident(depth, confidence, self.least_confidence, self.members.text(name))

    def __str__(self) -> str:
        return self.members.text(f"rgbd/{self.number}.depth")

    def _image(self, name: str, kind: type[np.generic]) -> Shaped[np.ndarray, "h w"]:
        """An image that is stored without its size, which follows from the aspect ratio."""
        data = decompress_lzfse(self.members.read(name, _LARGEST_IMAGE), self.members.text(name))
        itemsize = np.dtype(kind).itemsize
        count = len(data) // itemsize
        width = max(1, round((count * self.aspect) ** 0.5))
        if not count or len(data) % itemsize or count % width:
            raise FrameError(
                f"{self.members.text(name)} holds {len(data)} bytes, no image of colour's shape."
            )
        return np.frombuffer(data, kind).reshape(-1, width)
