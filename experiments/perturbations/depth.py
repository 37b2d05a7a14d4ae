"""Faults of depth images, with the parameters of Robust-Ego3D.

Source: Xu et al., Customizable perturbation synthesis for robust SLAM benchmarking (Robust-Ego3D), ICLR 2025.
"""

import cv2
import numpy as np
from jaxtyping import Float

from experiments.perturbations.colour import ImageChange, Random

Depth = Float[np.ndarray, "H W"]

_HOLE = 3
"""Half the side of a hole on an edge, pixels: 7 x 7 in all."""
_PATCH = 0.1
"""Side of a mask, in sides of the image."""


def depth_noise(depth: Depth, random: Random, share: float) -> Depth:
    """Normal noise whose mean and deviation are a share of the image's own: depth grows by it as well."""
    known = depth > 0
    if not known.any():
        return depth
    noise = random.normal(share * depth[known].mean(), share * depth[known].std(), depth.shape)
    return np.where(known, np.maximum(depth + noise, 0), 0)


def edge_erosion(depth: Depth, random: Random, share: float) -> Depth:
    """Edges of depth go, and around a share of their pixels holes of 7 x 7."""
    levels = cv2.normalize(depth, np.zeros(depth.shape, np.float32), 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    edges = cv2.Canny(levels, 20, 50) > 0
    rows, columns = np.nonzero(edges)
    chosen = random.permutation(len(rows))[: int(share * len(rows))]
    centres = np.zeros(depth.shape, np.uint8)
    centres[rows[chosen], columns[chosen]] = 1
    holes = cv2.dilate(centres, np.ones((2 * _HOLE + 1, 2 * _HOLE + 1), np.uint8)) > 0
    return np.where(edges | holes, 0, depth)


def random_masks(depth: Depth, random: Random, count: int) -> Depth:
    """Rectangles of a tenth of the image's sides without depth, at other places in each frame.

    The published code has ten of them whatever the severity; its numbers for the severities are used here.
    """
    return _masked(depth, random, count)


def fixed_masks(depth: Depth, random: Random, count: int) -> Depth:
    """The same, at the same places in all frames."""
    return _masked(depth, np.random.default_rng(count), count)


def range_crop(depth: Depth, random: Random, limits: tuple[float, float]) -> Depth:
    """No depth beyond a shortest and a longest distance, metres."""
    nearest, farthest = limits
    return np.where((depth >= nearest) & (depth <= farthest), depth, 0)


def _masked(depth: Depth, random: Random, count: int) -> Depth:
    height, width = (max(1, int(_PATCH * side)) for side in depth.shape)
    masked = depth.copy()
    for _ in range(count):
        top, left = random.integers(0, depth.shape[0] - height), random.integers(0, depth.shape[1] - width)
        masked[top : top + height, left : left + width] = 0
    return masked


DEPTH = {
    "depth noise": ImageChange(depth_noise, (0.1, 0.2, 0.3, 0.4, 0.5)),
    "depth edges": ImageChange(edge_erosion, (0.015, 0.02, 0.025, 0.03, 0.035)),
    "depth random masks": ImageChange(random_masks, (10, 15, 20, 25, 30)),
    "depth fixed masks": ImageChange(fixed_masks, (5, 7, 9, 11, 13)),
    "depth range": ImageChange(range_crop, ((0.2, 4.4), (0.3, 4.2), (0.4, 4.0), (0.5, 3.8), (0.6, 3.6))),
}
"""Perturbations of depth images in metres by name."""
