"""A sample of a recording: windows of frames that follow each other, spread evenly over it."""

import dataclasses
import itertools
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int8, UInt8

from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import Recording
from sfgs_jax.sensors import Outlines, colour_edges, depth_outlines

_WINDOWS, _WINDOW = 8, 20
_LARGEST_WIDTH = 640
"""Wider images are looked at in this width."""
_KEYS = (0.0, 0.1, 0.3, 0.6, 1.0)
"""Places in a window of the frames whose depth is kept, and that keypoints are found in."""


@dataclass(frozen=True)
class SampledFrame:
    """A frame, and the measures that are taken of each.

    Attributes:
        index: number in the recording.
        timestamp: seconds, of colour.
        depth_timestamp: seconds, of depth; None if not known.
        grey: brightness.
        edges: of `colour_edges`.
        outlines: of `depth_outlines`.
        seen: pixels that hold an image, not those beyond a lens's field of view.
        coverage: share of these with depth.
        depth: metres, 0 where missing; None unless the frame is a key frame of its window.
        depths: a thinned choice of the depths that are there, metres.
        depth_digest: equal for equal depth images.
    """

    index: int
    timestamp: float
    depth_timestamp: float | None
    grey: UInt8[np.ndarray, "h w"]
    edges: Int8[np.ndarray, "h w 2"]
    outlines: Outlines
    seen: Bool[np.ndarray, "h w"] | None
    coverage: float
    depth: Float[np.ndarray, "h w"] | None
    depths: Float[np.ndarray, " k"]
    depth_digest: int


@dataclass(frozen=True)
class RecordingSample:
    """Windows of consecutive frames.

    Attributes:
        recording: where they are from.
        windows: their frames, without those that could not be read.
        unreadable: numbers of these, with the reason.
        matrix: calibration matrix K of the sampled images.
        shape: height and width of these.
    """

    recording: Recording
    windows: Sequence[Sequence[SampledFrame]]
    unreadable: dict[int, str]
    matrix: Float[np.ndarray, "3 3"]
    shape: tuple[int, int]

    @property
    def frames(self) -> list[SampledFrame]:
        """All frames."""
        return [frame for window in self.windows for frame in window]

    @property
    def pixel(self) -> float:
        """A pixel of an image of 640, in pixels of these: the unit of limits on image errors."""
        return self.shape[1] / 640

    @property
    def depths(self) -> Float[np.ndarray, " n"]:
        """Depths of all frames, metres, thinned."""
        return np.concatenate([frame.depths for frame in self.frames])


def sample_recording(
    recording: Recording, progress: Callable[[int, int], object] | None = None
) -> RecordingSample:
    """Read windows of a recording.

    Args:
        recording: at least one frame.
        progress: called as `progress(done, total)` with numbers of frames.

    Raises:
        InputError: none of the frames can be read.
    """
    factor = max(1.0, recording.camera.width / _LARGEST_WIDTH)
    height, width = (round(side / factor) for side in recording.camera.shape)
    unreadable: dict[int, str] = {}
    windows = []
    chosen = _windows(len(recording))
    done, total = 0, sum(map(len, chosen))
    for indices in chosen:
        keys = {round(place * (len(indices) - 1)) for place in _KEYS}
        window = []
        for place, index in enumerate(indices):
            try:
                window.append(_sampled(recording, index, (height, width), keep_depth=place in keys))
            except FrameError as error:
                unreadable[index] = str(error)
            done += 1
            if progress is not None:
                progress(done, total)
        windows.append(window)
    if not any(windows):
        raise InputError(f"No frame of {recording.name} can be read: {next(iter(unreadable.values()))}")
    return RecordingSample(
        recording, windows, unreadable, _scaled_matrix(recording, height, width), (height, width)
    )


def with_focal_factor(sample: RecordingSample, factor: float) -> RecordingSample:
    """The sample with other focal lengths.

    Args:
        sample: of a recording.
        factor: on both.
    """
    return dataclasses.replace(sample, matrix=sample.matrix * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]])


def _windows(count: int) -> list[range]:
    if count <= _WINDOWS * _WINDOW:
        number = max(1, round(count / _WINDOW))
        bounds = np.linspace(0, count, number + 1).astype(int)
        return [range(first, last) for first, last in itertools.pairwise(bounds.tolist())]
    starts = np.linspace(0, count - _WINDOW, _WINDOWS).astype(int)
    return [range(start, start + _WINDOW) for start in starts]


def _sampled(recording: Recording, index: int, shape: tuple[int, int], *, keep_depth: bool) -> SampledFrame:
    frame = recording[index]
    rgb, depth = np.asarray(frame.rgb), np.asarray(frame.depth)
    seen = None if frame.valid is None else np.asarray(frame.valid)
    if depth.shape != shape:
        size = shape[::-1]
        rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
        depth = cv2.resize(depth, size, interpolation=cv2.INTER_NEAREST)
        if seen is not None:
            seen = cv2.resize(seen.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    grey = np.clip(np.rint(255 * cv2.transform(rgb, np.full((1, 3), 1 / 3))), 0, 255).astype(np.uint8)
    found = depth[depth > 0]
    total = depth.size if seen is None else max(1, np.count_nonzero(seen))
    return SampledFrame(
        index=index,
        timestamp=frame.timestamp,
        depth_timestamp=frame.depth_timestamp,
        grey=grey,
        edges=colour_edges(grey),
        outlines=depth_outlines(depth),
        seen=seen,
        coverage=float(len(found) / total),
        depth=depth if keep_depth else None,
        depths=found[:: max(1, len(found) // 2000)],
        depth_digest=zlib.crc32(depth.tobytes()),
    )


def _scaled_matrix(recording: Recording, height: int, width: int) -> Float[np.ndarray, "3 3"]:
    """K of the resized images; pixel centres lie at integers."""
    matrix = np.asarray(recording.camera.matrix(), np.float64)
    x, y = width / recording.camera.width, height / recording.camera.height
    matrix[0] *= x
    matrix[1] *= y
    matrix[0, 2] += (x - 1) / 2
    matrix[1, 2] += (y - 1) / 2
    return matrix
