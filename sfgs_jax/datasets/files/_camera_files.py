"""camera.json: the intrinsics that users write for their own recordings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sfgs_jax.arrays import InputError, excerpt, parsed_json, printable
from sfgs_jax.datasets.files._pose_files import read_text
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import Undistortion

CAMERA_EXAMPLE = '{"fx": 525.0, "fy": 525.0, "cx": 319.5, "cy": 239.5, "depth_scale": 1000.0}'
"""A camera.json, for error messages."""

_DISTORTION_COUNTS = (4, 5, 8)
# Of a focal length. Autofocus stays within the first, and the second moves a pixel of a small image.
_LARGEST_SPREAD = 0.05
_NOTED_SPREAD = 0.002
_NUMBERS = ("fx", "fy", "cx", "cy", "depth_scale", "width", "height", "fps")


@dataclass(frozen=True)
class Intrinsics:
    """Pinhole intrinsics before the size of the images is known, with the other entries of a camera file.

    Attributes:
        fx: focal length along u, pixels.
        fy: focal length along v, pixels.
        cx: principal point, column.
        cy: principal point, row.
        depth_scale: depth image units per metre, or None.
        fps: frames per second, or None.
        width: image width that these intrinsics belong to, or None.
        height: image height that these intrinsics belong to, or None.
        distortion: coefficients of OpenCV's lens model (k1, k2, p1, p2[, k3[, k4, k5, k6]]), none if empty.
        notes: warnings for the log.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    depth_scale: float | None = None
    fps: float | None = None
    width: int | None = None
    height: int | None = None
    distortion: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()

    def camera(self, width: int, height: int, source: Path) -> Camera:
        """Camera of images of this size.

        Args:
            width: image width, pixels.
            height: image height, pixels.
            source: the recording, for messages.

        Raises:
            InputError: a focal length is no positive number, the intrinsics belong to images of another size,
                or the principal point is outside.
        """
        if not (1e-3 < self.fx < 1e9 and 1e-3 < self.fy < 1e9):
            raise InputError(
                f"The focal lengths ({self.fx:g}, {self.fy:g}) of {source} should be positive, in pixels."
            )
        if not all(abs(x) < 1e6 for x in self.distortion):
            raise InputError(f"The lens coefficients of {source} should be finite and small numbers.")
        if (self.width or width, self.height or height) != (width, height):
            raise InputError(
                f"The intrinsics of {source} are for {self.width or '?'}x{self.height or '?'} images, "
                f"but the images are {width}x{height}; scale the intrinsics or the images."
            )
        if not (0 < self.cx < width and 0 < self.cy < height):
            raise InputError(
                f"The principal point ({self.cx:g}, {self.cy:g}) of {source} lies outside its "
                f"{width}x{height} images; give the intrinsics of images of that size."
            )
        return Camera(self.fx, self.fy, self.cx, self.cy, width=width, height=height)

    def pinhole(self, source: Path) -> "Intrinsics":
        """These intrinsics, for a layout whose depth is another camera's and can't be undistorted with it.

        Raises:
            InputError: there is distortion.
        """
        if any(self.distortion):
            raise InputError(
                f"The intrinsics of {source} have lens distortion, which is taken out only where colour and "
                "depth are registered already; undistort the images first (cv2.undistort)."
            )
        return self

    def undistortion(self, camera: Camera) -> Undistortion | None:
        """Undistortion of images of this camera; None without lens coefficients."""
        return Undistortion(camera, self.distortion) if any(self.distortion) else None


def own_camera(source: Path, given: Path | None) -> Intrinsics:
    """Intrinsics of a user's own recording: a given camera file, else the camera.json in its folder.

    Args:
        source: the folder.
        given: a camera file, or None.

    Raises:
        InputError: there is neither, or the file can't be understood.
    """
    path = given or source / "camera.json"
    if not path.is_file():
        raise InputError(f"Intrinsics of {source} are missing: write {path}, for example {CAMERA_EXAMPLE}.")
    return read_camera_json(path)


def one_camera(cameras: Sequence[Intrinsics], source: Path) -> Intrinsics:
    """The camera of frames that have intrinsics each: their median, since autofocus changes them a little.

    Args:
        cameras: of the frames, at least one.
        source: the recording, for messages.

    Raises:
        InputError: a number is not finite, sizes or lenses differ, or focal lengths or principal points do by
            more than 5 %.
    """
    first = cameras[0]
    numbers = np.asarray([(c.fx, c.fy, c.cx, c.cy) for c in cameras], np.float64)
    if not (np.abs(numbers) < 1e9).all():
        raise InputError(f"The focal lengths and principal points of {source} should be finite numbers.")
    median = np.median(numbers, axis=0)
    focal, spread = float(median[0]), float(np.max(np.abs(numbers - median)))
    same = all(
        (c.width, c.height, c.distortion) == (first.width, first.height, first.distortion) for c in cameras
    )
    if not same or spread > _LARGEST_SPREAD * focal:
        raise InputError(f"The frames of {source} have several cameras; give the frames of one camera.")
    if spread > _NOTED_SPREAD * focal:
        percent = 100 * spread / focal
        note = f"Intrinsics of {source} differ by up to {percent:.1f} % between frames; the median is used."
        first = replace(first, notes=(*first.notes, note))
    fx, fy, cx, cy = median.tolist()
    return replace(first, fx=fx, fy=fy, cx=cx, cy=cy)


def read_camera_json(path: Path) -> Intrinsics:
    """Read a camera.json: fx, fy, cx, cy in pixels; optional depth_scale, fps, width, height, distortion.

    Raises:
        InputError: the file can't be read, isn't JSON, or lacks a number.
    """
    try:
        content = parsed_json(read_text(path))
    except ValueError as error:
        raise InputError(
            f"{path} is not valid JSON ({excerpt(error)}); it should look like {CAMERA_EXAMPLE}."
        ) from error
    if not isinstance(content, dict):
        raise InputError(f"{path} must hold one JSON object such as {CAMERA_EXAMPLE}.")
    missing = [key for key in ("fx", "fy", "cx", "cy") if content.get(key) is None]
    if missing:
        raise InputError(f"{path} lacks {', '.join(missing)}; it should look like {CAMERA_EXAMPLE}.")
    values: dict[str, float] = {}
    for key in _NUMBERS:
        if content.get(key) is None:
            continue
        value = content[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not 1e-6 < value < 1e9:
            raise InputError(f"{path}: {key} must be a positive number, not {excerpt(value)}.")
        if key in ("width", "height") and value != int(value):
            raise InputError(f"{path}: {key} must be a whole number of pixels, not {excerpt(value)}.")
        values[key] = float(value)
    distortion = _distortion(content.get("distortion", []), path)
    unknown = sorted(set(content) - {*_NUMBERS, "distortion"})
    listed = printable(", ".join(unknown)[:100])
    notes = (f"{path} has entries that are not used: {listed}.",) if unknown else ()
    width, height = (int(values[key]) if key in values else None for key in ("width", "height"))
    return Intrinsics(
        fx=values["fx"],
        fy=values["fy"],
        cx=values["cx"],
        cy=values["cy"],
        depth_scale=values.get("depth_scale"),
        fps=values.get("fps"),
        width=width,
        height=height,
        distortion=distortion,
        notes=notes,
    )


def _distortion(value: object, path: Path) -> tuple[float, ...]:
    coefficients = value if isinstance(value, list) else [value]
    numbers = [
        x for x in coefficients if isinstance(x, int | float) and not isinstance(x, bool) and -1e6 < x < 1e6
    ]
    if value != [] and (len(numbers) != len(coefficients) or len(numbers) not in _DISTORTION_COUNTS):
        raise InputError(
            f"{path}: distortion must be a list of 4, 5 or 8 numbers (k1, k2, p1, p2, ...), "
            f"not {excerpt(value)}."
        )
    return tuple(float(x) for x in numbers)
