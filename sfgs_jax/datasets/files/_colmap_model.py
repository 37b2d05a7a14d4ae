"""COLMAP's sparse models: cameras and poses of images, from text or binary files.

Source: COLMAP's page on its output format. Poses are world to camera, principal points count from the
corner of the first pixel.
"""

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt, file_bytes
from sfgs_jax.datasets.files._camera_files import Intrinsics
from sfgs_jax.datasets.files._pose_files import inverse_poses, quaternion_poses, read_text

_T = TypeVar("_T")

_MODELS = {
    0: ("SIMPLE_PINHOLE", "fcc"),
    1: ("PINHOLE", "ffcc"),
    2: ("SIMPLE_RADIAL", "fcck"),
    3: ("RADIAL", "fcckk"),
    4: ("OPENCV", "ffcckkkk"),
    6: ("FULL_OPENCV", "ffcckkkkkkkk"),
}
"""Number and name of the camera models that OpenCV's lens model covers, and the kinds of their parameters."""

_PARAMETERS = dict(_MODELS.values())


@dataclass(frozen=True)
class ColmapModel:
    """A sparse model without its points.

    Attributes:
        cameras: intrinsics by camera number.
        images: camera number and `T_world_cam` by name of the image; a pose is NaN if it can't be used.
    """

    cameras: dict[int, Intrinsics]
    images: dict[str, tuple[int, Float[np.ndarray, "4 4"]]]


def has_colmap_model(folder: Path) -> bool:
    """True if a folder holds cameras and images as text or binary files."""
    return any(
        all((folder / f"{name}{suffix}").is_file() for name in ("cameras", "images"))
        for suffix in (".bin", ".txt")
    )


def read_colmap_model(folder: Path) -> ColmapModel:
    """Read cameras and images of a sparse model, the binary files if there are both.

    Raises:
        InputError: a file can't be read or understood, or a camera has a fisheye lens.
    """
    if all((folder / name).is_file() for name in ("cameras.bin", "images.bin")):
        cameras = _binary(folder / "cameras.bin", _binary_camera)
        images = _binary(folder / "images.bin", _binary_image)
    else:
        cameras = _text_cameras(folder / "cameras.txt")
        images = _text_images(folder / "images.txt")
    rows = np.asarray([row for _, _, row in images], np.float64).reshape(-1, 7)
    poses = inverse_poses(quaternion_poses(rows[:, 4:], rows[:, [1, 2, 3, 0]]))
    return ColmapModel(
        dict(cameras),
        {name: (camera, pose) for (name, camera, _), pose in zip(images, poses, strict=True)},
    )


_Image = tuple[str, int, tuple[float, ...]]
"""Name, camera number, and the pose's quaternion (wxyz) and translation."""


def _intrinsics(model: str, width: int, height: int, parameters: Sequence[float], path: Path) -> Intrinsics:
    kinds = _PARAMETERS.get(model)
    if kinds is None:
        raise InputError(
            f"{path}: cameras of the model {model[:40]} can't be read; undistort the images with COLMAP."
        )
    if len(parameters) != len(kinds):
        raise InputError(f"{path}: a camera of the model {model} has {len(kinds)} parameters.")
    fx, fy = parameters[0], parameters[kinds.count("f") - 1]
    cx, cy = parameters[kinds.index("c") :][:2]
    lens = [float(x) for x in parameters[kinds.index("c") + 2 :]]
    # OpenCV's order is k1, k2, p1, p2, k3, ...: a lens with radial terms only has no tangential ones.
    lens += [0.0] * (4 - len(lens))
    # Here pixel centres lie at integers.
    return Intrinsics(
        fx, fy, cx - 0.5, cy - 0.5, width=width, height=height, distortion=tuple(lens) if any(lens) else ()
    )


def _text_cameras(path: Path) -> list[tuple[int, Intrinsics]]:
    cameras = []
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        words = line.split("#")[0].split()
        if not words:
            continue
        try:
            key, width, height = (int(words[i]) for i in (0, 2, 3))
            parameters = [float(word) for word in words[4:]]
        except (ValueError, IndexError):
            raise InputError(
                f"{path}, line {number}: expected 'id model width height parameters', found {excerpt(line)}."
            ) from None
        cameras.append((key, _intrinsics(words[1], width, height, parameters, path)))
    return cameras


def _text_images(path: Path) -> list[_Image]:
    images = []
    lines = enumerate(read_text(path).splitlines(), start=1)
    for number, line in lines:
        if not line.strip() or line.startswith("#"):
            continue
        words = line.split(maxsplit=9)
        try:
            images.append((words[9].strip(), int(words[8]), tuple(float(word) for word in words[1:8])))
        except (ValueError, IndexError):
            raise InputError(
                f"{path}, line {number}: expected 'id qw qx qy qz tx ty tz camera name', "
                f"found {excerpt(line)}."
            ) from None
        next(lines, None)  # its points, an empty line if it has none
    return images


def _binary(path: Path, read_one: Callable[["_Bytes", Path], _T]) -> list[_T]:
    """The entries of a binary file: their number, then one after the other."""
    try:
        data = _Bytes(file_bytes(path))
        (count,) = data.unpack("<Q")
        # A count beyond the file's length ends at the file's end, before anything of its size is made.
        return [read_one(data, path) for _ in range(count)]
    except OSError as error:
        raise InputError(f"Cannot read {path}: {excerpt(error)}.") from error
    except (struct.error, ValueError, OverflowError) as error:
        raise InputError(f"{path} is damaged or is no binary file of COLMAP ({excerpt(error)}).") from error


class _Bytes:
    """Bytes that are unpacked from the front."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._at = 0

    def unpack(self, layout: str) -> tuple:
        """Values of a struct layout. Raises struct.error behind the end."""
        values = struct.unpack_from(layout, self._data, self._at)
        self._at += struct.calcsize(layout)
        return values

    def text(self) -> str:
        """Text up to the next zero. Raises ValueError if there is none."""
        end = self._data.index(b"\0", self._at)
        text = self._data[self._at : end].decode("utf-8")
        self._at = end + 1
        return text

    def skip(self, count: int) -> None:
        """Pass over bytes. Raises ValueError behind the end."""
        if self._at + count > len(self._data):
            raise ValueError("it ends too early")
        self._at += count


def _binary_camera(data: _Bytes, path: Path) -> tuple[int, Intrinsics]:
    key, number, width, height = data.unpack("<iiQQ")
    model, kinds = _MODELS.get(number, (f"number {number}", ""))
    return key, _intrinsics(model, width, height, data.unpack(f"<{len(kinds)}d"), path)


def _binary_image(data: _Bytes, path: Path) -> _Image:
    _, *pose, camera = data.unpack("<I7dI")
    name = data.text()
    (num_points,) = data.unpack("<Q")
    data.skip(24 * num_points)
    return name, camera, tuple(pose)
