"""A recording whose frames are pairs of images; every layout on disk becomes one."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float, Shaped

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets.files._images import ColourImage, DepthImage, decode_colour, decode_depth
from sfgs_jax.geometry import Camera, Frame, Trajectory

# The first frames of a recording may be damaged; so many are tried to learn the images' size.
_NUM_PROBED = 10
# A median depth out of this range, metres, means that the scale is wrong, not that the room is odd.
_PLAUSIBLE_DEPTH = (0.05, 50.0)
# Seconds; 30,000 years.
_LATEST = 1e12


@runtime_checkable
class PairRegistration(Protocol):
    """Brings a decoded pair of images into one camera."""

    @property
    def valid(self) -> Bool[np.ndarray, "h w"] | None:
        """Pixels of the result that the colour camera saw; None if it saw all."""
        ...

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h3 w3 3"], Float[np.ndarray, "h3 w3"]]:
        """Colour and depth as that camera sees them; raises FrameError for images of a wrong size."""
        ...


@dataclass(frozen=True)
class FilePair:
    """The two images of one frame.

    Attributes:
        colour: file of the colour image, or an image that decodes itself.
        depth: file of the depth image, or an image that decodes itself.
        timestamp: seconds.
        depth_timestamp: seconds, of the depth image; None if not known.
    """

    colour: Path | ColourImage
    depth: Path | DepthImage
    timestamp: float
    depth_timestamp: float | None = None


@dataclass(frozen=True)
class FileRecording:
    """A `Recording` of image files; `Recording` describes the attributes that are not listed here.

    Attributes:
        pairs: the files of each frame.
        units_per_metre: depth image units per metre; None means 1000 for integers, 1 for floating point.
        register: brings a decoded pair into one camera; None if colour and depth share a camera already.
    """

    name: str
    dataset: str
    camera: Camera
    pairs: Sequence[FilePair]
    units_per_metre: float | None
    ground_truth: Trajectory | None
    notes: tuple[str, ...]
    register: PairRegistration | None = None

    def __post_init__(self) -> None:
        """Raise InputError if a time stamp can't be one."""
        wrong = [time for time in self.timestamps.tolist() if not abs(time) < _LATEST]
        if wrong:
            raise InputError(f"{self.name} has a frame at {wrong[0]:g}, which is no time stamp in seconds.")

    @property
    def timestamps(self) -> Float[np.ndarray, " n"]:
        """Seconds, float64."""
        return np.asarray([pair.timestamp for pair in self.pairs], np.float64)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> Frame:
        pair = self.pairs[index]
        rgb = decode_colour(pair.colour)
        depth = decode_depth(pair.depth, self.units_per_metre)
        if self.register is not None:
            rgb, depth = self.register(rgb, depth)
        if rgb.shape[:2] != depth.shape:
            raise FrameError(
                f"{pair.colour} is {size_text(rgb)} but {pair.depth} is {size_text(depth)}; "
                "sizes must be equal."
            )
        if depth.shape != self.camera.shape:
            expected = f"{self.camera.width}x{self.camera.height}"
            raise FrameError(f"{pair.colour} is {size_text(rgb)}, other than the recording's {expected}.")
        valid = None if self.register is None else self.register.valid
        return Frame(rgb, depth, pair.timestamp, pair.depth_timestamp, valid)


def first_readable(
    source: Path, pairs: Sequence[FilePair], units_per_metre: float | None
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h2 w2"]]:
    """Colour and depth of the first frame that can be decoded, to learn the images' sizes from.

    Args:
        source: the recording, for messages.
        pairs: its files.
        units_per_metre: as in `decode_depth`.

    Raises:
        InputError: there are no frames, or none of the first ones can be read.
    """
    if units_per_metre is not None and not 1e-6 < units_per_metre < 1e9:
        raise InputError(f"The depth scale of {source} should be units per metre, not {units_per_metre:g}.")
    if not pairs:
        raise InputError(f"No pairs of colour and depth images found in {source}.")
    first_error: FrameError | None = None
    for pair in pairs[:_NUM_PROBED]:
        try:
            return decode_colour(pair.colour), decode_depth(pair.depth, units_per_metre)
        except FrameError as error:
            first_error = first_error or error
    raise InputError(f"None of the first frames of {source} can be read: {first_error}")


def registered_size(
    source: Path, pairs: Sequence[FilePair], units_per_metre: float | None
) -> tuple[int, int, tuple[str, ...]]:
    """Size of the images of a recording whose depth is registered already. Arguments as of `first_readable`.

    Returns:
        Width, height, and notes for the log.

    Raises:
        InputError: as `first_readable`, or colour and depth differ in size.
    """
    rgb, depth = first_readable(source, pairs, units_per_metre)
    if rgb.shape[:2] != depth.shape:
        raise InputError(
            f"Colour images of {source} are {size_text(rgb)} but depth images are {size_text(depth)}; "
            "register depth to the colour camera and save both at one size."
        )
    return depth.shape[1], depth.shape[0], depth_notes(depth)


def depth_notes(depth: Float[np.ndarray, "h w"]) -> tuple[str, ...]:
    """A note if depth, in metres, is so far from a room's that its scale must be wrong; else no note."""
    valid = depth[depth > 0]
    low, high = _PLAUSIBLE_DEPTH
    if len(valid) and not low < (median := float(np.median(valid))) < high:
        return (f"The median depth of the first frame is {median:.3g} m; check the depth scale.",)
    return ()


def size_text(image: Shaped[np.ndarray, "h w *channels"]) -> str:
    """Width x height, for messages."""
    return f"{image.shape[1]}x{image.shape[0]}"
