"""Outlines in depth and edges in colour: they lie along each other only if the two images belong together."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Int, Int8, UInt8

from sfgs_jax.arrays import checked

_JUMP = 1.05
"""Ratio of depths across an outline."""
_CAP = 4.0
"""Largest gradient that counts, in means of its image: one lamp must not speak for a whole image."""
_STEP = 1 / 30
"""Unit that edges are kept in."""
_MOST = 3000
"""Pixels of outlines that are kept of an image."""


class Outlines(NamedTuple):
    """Pixels where a surface ends in front of another.

    Attributes:
        pixels: (..., n, 2) as (u, v).
        across: (..., n, 2) unit vectors across the outline; 0 where none can be told.
    """

    pixels: Int[np.ndarray, "... n 2"]
    across: Float[np.ndarray, "... n 2"]

    def every(self, step: int) -> "Outlines":
        """Every so many of them, (n, 2).

        Args:
            step: from one to the next, at least 1.
        """
        return Outlines(self.pixels[::step], self.across[::step])

    def moved(self, by: int) -> "Outlines":
        """The same, moved across the outlines towards what is near.

        Args:
            by: pixels.
        """
        return Outlines(np.rint(self.pixels + by * self.across).astype(self.pixels.dtype), self.across)


@checked
def colour_edges(grey: UInt8[np.ndarray, "h w"]) -> Int8[np.ndarray, "h w 2"]:
    """Gradient of an image, as a vector of double its angle: opposite directions are one.

    Its length is in thirtieths of the image's mean, capped. The mean vector is taken off, so an image whose
    edges all run alike agrees with outlines by chance no more than others do.

    Args:
        grey: brightness.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0)
    x, y = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    length = cv2.magnitude(x, y)
    capped = np.minimum(length / max(float(length.mean()), 1e-6), np.float32(_CAP))
    scale = capped / (np.float32(_STEP) * np.maximum(length, np.float32(1e-6)) ** 2)
    doubled = [scale * part for part in _of_double_angle(x, y)]
    rounded = [np.rint(part - part.mean()).clip(-127, 127).astype(np.int8) for part in doubled]
    return np.stack(rounded, axis=-1)


@checked
def depth_outlines(depth: Float[np.ndarray, "h w"]) -> Outlines:
    """Pixels on the near side of a jump of depth: there a surface ends, and its picture with it.

    Args:
        depth: in any unit; 0 where missing.

    Returns:
        An evenly thinned choice; none where there are so few that they may be noise.
    """
    there = depth > 0
    # A sensor has no depth right behind an outline, so a missing pixel may lie in between.
    far = cv2.dilate(depth, np.ones((5, 5), np.uint8))
    near = cv2.erode(np.where(there, depth, np.float32(np.inf)), np.ones((3, 3), np.uint8))
    mask = there & (far > _JUMP * depth) & (depth / np.float32(1.01) < near)
    mask[:2] = mask[-2:] = mask[:, :2] = mask[:, -2:] = False
    rows, columns = np.nonzero(mask)
    if len(rows) < max(20, depth.size // 3000):
        return Outlines(np.zeros((0, 2), np.int32), np.zeros((0, 2), np.float32))
    thinned = slice(None, None, -(-len(rows) // _MOST))
    rows, columns = rows[thinned], columns[thinned]
    # As inverse depth. A pixel without depth around it counts as infinitely far.
    filled = np.where(there, depth, np.where(far > 0, far, np.float32(np.inf)))
    smooth = cv2.GaussianBlur(near.min() / filled, (0, 0), 1.0)
    x, y = cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1)
    across = np.stack([x[rows, columns], y[rows, columns]], axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), np.float32(1e-12))
    return Outlines(np.c_[columns, rows].astype(np.int32), across)


@checked
def outline_agreement(edges: Int8[np.ndarray, "k h w 2"], outlines: Outlines) -> Float[np.ndarray, "s k"]:
    """Mean colour edge along depth's outlines: 0 by chance, 0.3 to 3 where they belong together.

    An edge of length g at an angle a to the outline counts as g cos 2a.

    Args:
        edges: of `colour_edges`, of k images.
        outlines: of `depth_outlines`, (s, n, 2), in s places; what lies out of the image does not count.

    Returns:
        Of each place and image; NaN where no outline lies in the image.
    """
    height, width = edges.shape[1:3]
    # In int16, as they may be stored, the index of a pixel would wrap around.
    columns, rows = np.moveaxis(outlines.pixels.astype(np.intp), -1, 0)
    within = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    flat = np.where(within, rows * width + columns, 0)
    doubled = np.stack(_of_double_angle(*np.moveaxis(outlines.across, -1, 0)), axis=-1)
    across = np.where(within[..., None], doubled, 0)
    values = edges.reshape(len(edges), -1, 2)[:, flat].astype(np.float32)
    sums = _STEP * np.einsum("ksnd,snd->sk", values, across, dtype=np.float64)
    counts = np.count_nonzero(within, axis=1)[:, None]
    return np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)


def _of_double_angle(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vectors of double the angle and the square of the length."""
    return x * x - y * y, 2 * x * y
