"""Depth with a map of confidence, as phones with a LiDAR store it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets.files._file_recording import size_text
from sfgs_jax.datasets.files._images import decode_depth, read_levels


@dataclass(frozen=True)
class ConfidentDepth:
    """A depth image without its pixels of low confidence, as a `DepthImage`.

    Attributes:
        depth: file of the depth image.
        confidence: file of the map of confidence: 0 low, 1 medium, 2 high.
        least: least confidence of a pixel that is kept.
    """

    depth: Path
    confidence: Path
    least: int

    def metres(self, units_per_metre: float | None) -> Float[np.ndarray, "h w"]:
        """Depth in metres, 0 where missing or of low confidence. Errors as of `decode_depth`."""
        depth = decode_depth(self.depth, units_per_metre)
        return confident(depth, read_levels(self.confidence), self.least, str(self.confidence))

    def __str__(self) -> str:
        return str(self.depth)


def confident(
    depth: Float[np.ndarray, "h w"], confidence: UInt8[np.ndarray, "h2 w2"], least: int, name: str
) -> Float[np.ndarray, "h w"]:
    """Depth where confidence is at least `least`, elsewhere 0.

    Args:
        depth: metres.
        confidence: of each pixel, of the depth image's size.
        least: least confidence that is kept.
        name: what to call the map in an error.

    Raises:
        FrameError: the sizes differ.
    """
    if confidence.shape != depth.shape:
        raise FrameError(f"{name} is {size_text(confidence)}, but its depth image is {size_text(depth)}.")
    return np.where(confidence >= least, depth, np.float32(0))
