"""Pairs made of one photograph, like those of HPatches: another viewpoint, or another illumination."""

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from sfgs_jax.datasets import Photos

_CORNER_SHIFT = 0.2
"""Range of each corner's motion, as a share of the image's sides."""

_MAX_ROTATION_DEG = 25.0
_SCALES = (0.75, 1.3)


@dataclass(frozen=True)
class WarpedPhoto:
    """A photograph and a changed copy of it.

    Attributes:
        group: "viewpoint" or "illumination".
        image_a: (H, W, 3) RGB in [0, 1].
        image_b: (H, W, 3) the changed one.
        H_b_a: (3, 3) takes pixels (u, v) of image a to image b.
    """

    group: str
    image_a: np.ndarray
    image_b: np.ndarray
    H_b_a: np.ndarray


def warped_photos(photos: Photos, *, count: int, seed: int) -> Iterator[WarpedPhoto]:
    """Pairs of both groups for photographs spread evenly over a set.

    Args:
        photos: the set.
        count: number of photographs.
        seed: the same seed gives the same pairs.
    """
    for index in np.linspace(0, len(photos) - 1, min(count, len(photos))).astype(int).tolist():
        rng = np.random.default_rng((seed, index))
        image = photos[index]
        H_b_a = random_homography(rng, image.shape[0], image.shape[1])
        # Mirrored rather than black beyond the photograph, so that its border makes no corners.
        warped = cv2.warpPerspective(
            image, H_b_a, image.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
        )
        yield WarpedPhoto("viewpoint", image, _noisy(rng, np.asarray(warped), 0.01), H_b_a)
        yield WarpedPhoto("illumination", image, other_light(rng, image), np.eye(3))


def random_homography(rng: np.random.Generator, height: int, width: int) -> np.ndarray:
    """Random homography (3, 3): rotation and scale about the middle, and corners moved by themselves.

    Args:
        rng: source of the random numbers.
        height: of the image, pixels.
        width: of the image, pixels.
    """
    corners = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], np.float64)
    centre = corners.mean(axis=0)
    angle = np.radians(rng.uniform(-_MAX_ROTATION_DEG, _MAX_ROTATION_DEG))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    scale = np.exp(rng.uniform(*np.log(_SCALES)))
    moved = (corners - centre) @ (scale * turn).T + centre
    moved += rng.uniform(-_CORNER_SHIFT / 2, _CORNER_SHIFT / 2, (4, 2)) * [width, height]
    return cv2.getPerspectiveTransform(corners.astype(np.float32), moved.astype(np.float32))


def other_light(rng: np.random.Generator, image: np.ndarray) -> np.ndarray:
    """The image with another exposure, contrast and colour of light, light from one side, and more noise."""
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width] / max(height, width) - 0.5
    angle = rng.uniform(0, 2 * np.pi)
    side = 1 + rng.uniform(0.2, 0.9) * (np.cos(angle) * u + np.sin(angle) * v)
    gain = rng.uniform(0.4, 1.4) * rng.uniform(0.85, 1.15, 3)
    lit = np.clip(image, 0, 1) ** rng.uniform(0.6, 1.8) * side[..., None] * gain
    return _noisy(rng, lit, rng.uniform(0.01, 0.03))


def _noisy(rng: np.random.Generator, image: np.ndarray, sigma: float) -> np.ndarray:
    return np.clip(image + rng.normal(0, sigma, image.shape), 0, 1).astype(np.float32)
