"""Outlines in depth and edges in colour: they lie on each other only if the two images belong together."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Real, UInt8

from sfgs_jax.arrays import checked

_JUMP = 1.05
"""Ratio of depths across an outline."""
_CAP = 4.0
"""Largest gradient that counts, in means of its image: one lamp must not speak for a whole image."""
_MOST = 3000
"""Pixels of outlines that are kept of an image."""


@checked
def colour_edges(grey: UInt8[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Gradient of an image in units of its mean, capped, less its mean: 0 on average.

    Args:
        grey: brightness.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), 1.0)
    gradient = cv2.magnitude(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    scaled = np.minimum(gradient / max(float(gradient.mean()), 1e-6), np.float32(_CAP))
    return scaled - scaled.mean()


@checked
def depth_outlines(depth: Float[np.ndarray, "h w"]) -> Int[np.ndarray, "n 2"]:
    """Pixels (u, v) on the near side of a jump of depth: there a surface ends, and its picture with it.

    Args:
        depth: in any unit; 0 where missing.

    Returns:
        An evenly thinned choice; none where there are so few that they may be noise.
    """
    mask = _near_sides(depth)
    mask[:2] = mask[-2:] = mask[:, :2] = mask[:, -2:] = False
    rows, columns = np.nonzero(mask)
    if len(rows) < max(20, depth.size // 3000):
        return np.zeros((0, 2), np.int32)
    return np.c_[columns, rows][:: -(-len(rows) // _MOST)].astype(np.int32)


def _near_sides(depth: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    # A sensor has no depth right behind an outline, so a missing pixel may lie in between.
    far = cv2.dilate(depth, np.ones((5, 5), np.uint8))
    near = cv2.erode(np.where(depth > 0, depth, np.float32(1e9)), np.ones((3, 3), np.uint8))
    return (depth > 0) & (far > _JUMP * depth) & (depth < 1.01 * near)


@checked
def outline_agreement(
    edges: Real[np.ndarray, "k h w"], outlines: Int[np.ndarray, "s n 2"]
) -> Float[np.ndarray, "s k"]:
    """Mean colour edge on depth's outlines: 0 by chance, 0.3 to 3 where they belong together.

    Args:
        edges: of `colour_edges`, of k images.
        outlines: of `depth_outlines`, in s places; what lies out of the image does not count.

    Returns:
        Of each place and image; NaN where no outline lies in the image.
    """
    height, width = edges.shape[1:]
    # In int16, as they are stored, the index of a pixel would wrap around.
    columns, rows = outlines[..., 0].astype(np.intp), outlines[..., 1].astype(np.intp)
    within = (columns >= 0) & (rows >= 0) & (columns < width) & (rows < height)
    flat = np.where(within, rows * width + columns, 0)
    values = np.where(within, edges.reshape(len(edges), -1)[:, flat], 0)
    counts = np.count_nonzero(within, axis=1)
    sums = values.sum(axis=2, dtype=np.float64)
    return np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0).T
