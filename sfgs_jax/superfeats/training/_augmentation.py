"""Augmentation: changes of view, light and sight that make training pairs of single images, on the host."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from sfgs_jax.arrays import InputError, check_range, checked

_MAX_SHRINKAGE = 4.0
"""Largest shrinkage of an image by a view that the blur against aliasing follows."""


@dataclass(frozen=True)
class ViewConfig:
    """Largest differences of two views of the same image.

    Raises:
        InputError: a setting is out of its range.
    """

    max_rotation_deg: float = 40.0
    """Largest angle by which the second view is turned, degrees; at least 0. Small angles are more likely."""

    scale: tuple[float, float] = (0.6, 1.6)
    """Least and greatest scale of the second view to the first; positive."""

    perspective: float = 0.18
    """Largest shift of each corner by itself, as a share of the view's side; from 0 to below 0.5."""

    translation: float = 0.15
    """Largest shift of the whole view, as a share of its side; at least 0."""

    def __post_init__(self) -> None:
        low, high = self.scale
        check_range(self, 0, math.inf, "max_rotation_deg", "translation")
        if not 0 < low <= high < math.inf:
            raise InputError(f"{self}: the scales must be finite, and 0 < least scale <= greatest.")
        if not 0 <= self.perspective < 0.5:
            raise InputError(f"{self}: corners that move by half a side or more turn the view inside out.")


@checked
def random_homography(
    rng: np.random.Generator,
    size: int,
    config: ViewConfig = ViewConfig(),
) -> Float64[np.ndarray, "3 3"]:
    """A homography of one square image onto another: rotation, scale, shift, and corners moved about.

    Args:
        rng: source of the random numbers.
        size: side of both images, pixels.
        config: largest changes.
    """
    # Most pairs turn little: a camera held upright is the common case.
    angle = np.deg2rad(config.max_rotation_deg) * rng.uniform(-1, 1) ** 3
    scale = np.exp(rng.uniform(*np.log(config.scale)))
    shift = rng.uniform(-config.translation, config.translation, 2) * size
    centre = (size - 1) / 2
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size / 2
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = corners @ turn.T * scale + rng.uniform(-1, 1, (4, 2)) * config.perspective * size
    source = (corners + centre).astype(np.float32)
    target = (moved + centre + shift).astype(np.float32)
    return cv2.getPerspectiveTransform(source, target)


@checked
def warp(
    image: Float32[np.ndarray, "h w"], H_view_image: Float64[np.ndarray, "3 3"], size: int
) -> Float32[np.ndarray, "s s"]:
    """A square view of an image through a homography; the image is mirrored beyond its border.

    Args:
        image: (H, W) grey.
        H_view_image: (3, 3) takes pixels (u, v) of the image to the view's.
        size: side of the view, pixels.
    """
    # A blur before the view shrinks the image prevents aliasing.
    shrink = min(_shrinkage(H_view_image, size), _MAX_SHRINKAGE)
    if shrink > 1.2:
        image = cv2.GaussianBlur(image, (0, 0), 0.4 * shrink)
    return cv2.warpPerspective(
        image, H_view_image, (size, size), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101
    )


@checked
def relight(
    rng: np.random.Generator, image: Float32[np.ndarray, "s s"], strength: float = 1.0
) -> Float32[np.ndarray, "s s"]:
    """Gamma, contrast, brightness, a soft shadow, blur and noise, each at random; values stay in [0, 1].

    Args:
        rng: source of the random numbers.
        image: (S, S) grey, in [0, 1].
        strength: factor on all changes.
    """
    size = image.shape[0]
    # Interpolation can leave a value a rounding error below zero, whose power is NaN.
    image = np.clip(image, 0, 1) ** np.float32(np.exp(strength * rng.uniform(-0.5, 0.5)))
    image = (image - 0.5) * np.float32(np.exp(strength * rng.uniform(-0.4, 0.3))) + 0.5
    image = image + np.float32(strength * rng.uniform(-0.15, 0.15))
    if rng.random() < 0.3 * strength:
        coarse = rng.uniform(0.5, 1.1, (4, 4)).astype(np.float32)
        image = image * cv2.resize(coarse, (size, size), interpolation=cv2.INTER_CUBIC)
    blurred = rng.random()
    if blurred < 0.15 * strength:
        image = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.5, 1.5))
    elif blurred < 0.3 * strength:
        image = motion_blur(rng, image)
    noise = np.float32(rng.uniform(0, 0.03) * strength)
    image = image + noise * rng.standard_normal(image.shape, dtype=np.float32)
    return np.clip(image, 0, 1)


@checked
def occlude(
    rng: np.random.Generator, image: Float32[np.ndarray, "s s"]
) -> tuple[Float32[np.ndarray, "s s"], Bool[np.ndarray, "s s"]]:
    """Cover parts of an image with up to three rectangles, ellipses or polygons.

    Args:
        rng: source of the random numbers.
        image: (S, S) grey, in [0, 1].

    Returns:
        The image, and the mask (S, S) of the pixels that were covered.
    """
    size = image.shape[0]
    mask = np.zeros(image.shape, np.uint8)
    image = image.copy()
    for _ in range(rng.integers(0, 4)):
        shape = np.zeros_like(mask)
        centre = rng.integers(0, size, 2)
        extent = rng.integers(size // 32 + 1, size // 6 + 2, 2)
        kind = rng.integers(3)
        if kind == 0:
            low, high = centre - extent, centre + extent
            cv2.rectangle(shape, (int(low[0]), int(low[1])), (int(high[0]), int(high[1])), 1, -1)
        elif kind == 1:
            axes = (int(extent[0]), int(extent[1]))
            cv2.ellipse(
                shape, (int(centre[0]), int(centre[1])), axes, float(rng.uniform(0, 180)), 0, 360, 1, -1
            )
        else:
            corners = centre + rng.uniform(-1, 1, (5, 2)) * extent
            cv2.fillPoly(shape, [cv2.convexHull(corners.astype(np.int32))], 1)
        inside = shape > 0
        fill = rng.uniform(0, 1) + 0.1 * rng.standard_normal(int(inside.sum()))
        image[inside] = np.clip(fill, 0, 1).astype(np.float32)
        mask |= shape
    return image, mask > 0


def _shrinkage(H_view_image: Float64[np.ndarray, "3 3"], size: int) -> float:
    """Number of the image's pixels, along a side, that fall into one pixel at the view's centre."""
    centre = (size - 1) / 2
    square = np.array([[centre, centre, 1], [centre + 1, centre, 1], [centre, centre + 1, 1]])
    there = square @ np.linalg.inv(H_view_image).T
    corner, right, below = there[:, :2] / there[:, 2:]
    return float(np.sqrt(abs(np.linalg.det(np.stack([right - corner, below - corner])))))


@checked
def motion_blur(
    rng: np.random.Generator, image: Float32[np.ndarray, "*size"], lengths: tuple[int, int] = (3, 9)
) -> Float32[np.ndarray, "*size"]:
    """Blur by a straight motion in a random direction.

    Args:
        rng: source of the random numbers.
        image: (H, W) or (H, W, 3).
        lengths: least and greatest length of the motion, whole pixels.
    """
    length = int(rng.integers(*lengths, endpoint=True))
    kernel = np.zeros((length, length), np.float32)
    angle = rng.uniform(0, np.pi)
    reach = (length - 1) / 2 * np.array([np.cos(angle), np.sin(angle)])
    start, end = (length - 1) / 2 - reach, (length - 1) / 2 + reach
    cv2.line(
        kernel, tuple(np.round(start).astype(int).tolist()), tuple(np.round(end).astype(int).tolist()), 1
    )
    return cv2.filter2D(image, -1, kernel / kernel.sum())
