"""Noise, blur, light, weather and coding of colour images, with the parameters of ImageNet-C.

Source: Hendrycks and Dietterich, Benchmarking neural network robustness to common corruptions, ICLR 2019.
Robust-Ego3D (Xu et al., ICLR 2025) applies them to recordings. Lengths are in pixels, whatever the image's
size: a small image suffers more. Frost needs photographs of frost, and spatter is left out as well.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

Image = Float[np.ndarray, "H W 3"]
Plane = Float[np.ndarray, "H W"]
Random = np.random.Generator


class ImageChange(NamedTuple):
    """A perturbation of one image.

    Attributes:
        apply: from the image, random numbers and a parameter to another image, not yet cut to [0, 1].
        parameters: of severities 1 to 5.
    """

    apply: Callable[[Any, Random, Any], Any]
    parameters: tuple[Any, ...]


def gaussian_noise(image: Image, random: Random, sigma: float) -> Image:
    """White noise of standard deviation `sigma`."""
    return image + random.normal(0, sigma, image.shape)


def shot_noise(image: Image, random: Random, photons: float) -> Image:
    """Poisson noise of a pixel whose full scale is a number of photons."""
    return random.poisson(image * photons) / photons


def impulse_noise(image: Image, random: Random, share: float) -> Image:
    """Salt and pepper: a share of the values becomes 0 or 1."""
    return np.where(random.random(image.shape) < share, random.integers(0, 2, image.shape), image)


def speckle_noise(image: Image, random: Random, sigma: float) -> Image:
    """Noise that grows with the value."""
    return image * (1 + random.normal(0, sigma, image.shape))


def gaussian_blur(image: Image, random: Random, sigma: float) -> Image:
    """Gaussian of standard deviation `sigma` pixels."""
    return cv2.GaussianBlur(image, (0, 0), sigma)


def defocus(image: Image, random: Random, parameter: tuple[int, float]) -> Image:
    """Disc of a radius, its edge softened by a Gaussian, both in pixels."""
    radius, softness = parameter
    y, x = np.mgrid[-radius - 1 : radius + 2, -radius - 1 : radius + 2]
    disc = (x * x + y * y <= radius * radius).astype(np.float32)
    disc = cv2.GaussianBlur(disc, (0, 0), softness)
    return cv2.filter2D(image, -1, disc / disc.sum(), borderType=cv2.BORDER_REFLECT)


def motion_blur(image: Image, random: Random, parameter: tuple[int, float]) -> Image:
    """One-sided Gaussian along a line within 45 degrees of level; radius and deviation in pixels."""
    radius, sigma = parameter
    return _along_line(image, radius, sigma, np.radians(random.uniform(-45, 45)))


def glass_blur(image: Image, random: Random, parameter: tuple[float, int, int]) -> Image:
    """Pixels change places with near ones, between two blurs; deviation, reach and rounds."""
    sigma, reach, rounds = parameter
    image = cv2.GaussianBlur(image, (0, 0), sigma)
    height, width = image.shape[:2]
    v, u = np.mgrid[:height, :width]
    for _ in range(rounds):
        dv, du = random.integers(-reach, reach + 1, (2, height, width))
        image = image[np.clip(v + dv, 0, height - 1), np.clip(u + du, 0, width - 1)]
    return cv2.GaussianBlur(image, (0, 0), sigma)


def brightness(image: Image, random: Random, added: float) -> Image:
    """The value of HSV, which is a pixel's largest channel, plus a number, with hue and saturation kept."""
    value = image.max(axis=2, keepdims=True)
    brighter = np.minimum(value + added, 1)
    return np.where(value > 0, image * brighter / np.maximum(value, 1e-6), brighter)


def contrast(image: Image, random: Random, factor: float) -> Image:
    """Distance of each channel from its mean, by a factor."""
    mean = image.mean(axis=(0, 1), keepdims=True)
    return mean + factor * (image - mean)


def fog(image: Image, random: Random, parameter: tuple[float, float]) -> Image:
    """Clouds of fractal noise, thickness and decay from one octave to the next, then the old full scale."""
    thickness, decay = parameter
    full = image.max()
    clouds = fractal_noise(image.shape[:2], random, decay)[..., None]
    return (image + thickness * clouds) * full / (full + thickness)


def snow(image: Image, random: Random, parameter: tuple[float, ...]) -> Image:
    """Blurred flakes over a paler image; mean, deviation, zoom, threshold, radius, sigma, image's share."""
    mean, deviation, zoom, threshold, radius, sigma, share = parameter
    height, width = image.shape[:2]
    small = (max(1, round(height / zoom)), max(1, round(width / zoom)))
    flakes = cv2.resize(random.normal(mean, deviation, small).astype(np.float32), (width, height))
    flakes = np.clip(np.where(flakes < threshold, 0, flakes), 0, 1)
    flakes = _along_line(flakes, int(radius), sigma, np.radians(random.uniform(-135, -45)))[..., None]
    grey = image.mean(axis=2, keepdims=True)
    pale = share * image + (1 - share) * np.maximum(image, 1.5 * grey + 0.5)
    return pale + flakes + flakes[::-1, ::-1]


def jpeg(image: Image, random: Random, quality: int) -> Image:
    """Compression by JPEG."""
    levels = np.round(255 * np.clip(image, 0, 1)).astype(np.uint8)
    _, coded = cv2.imencode(".jpg", levels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, int(quality)])
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_COLOR))[..., ::-1] / 255


def pixelate(image: Image, random: Random, share: float) -> Image:
    """Fewer pixels, by means over areas, then as many as before by repetition."""
    height, width = image.shape[:2]
    small = cv2.resize(image, (int(width * share), int(height * share)), interpolation=cv2.INTER_AREA)
    return cv2.resize(small, (width, height), interpolation=cv2.INTER_NEAREST)


def fractal_noise(shape: tuple[int, int], random: Random, decay: float) -> Plane:
    """Noise whose octaves shrink by `decay` from one to the next finer one, scaled to [0, 1].

    Args:
        shape: of the image.
        random: source of the values.
        decay: above 1; more is smoother.
    """
    size = (shape[1], shape[0])
    total, weight, cells = np.zeros(shape), 1.0, 2
    while cells <= max(shape):
        octave = random.uniform(-1, 1, (cells + 1, cells + 1))
        total += weight * cv2.resize(octave, size, interpolation=cv2.INTER_LINEAR)
        weight, cells = weight / decay, 2 * cells
    total -= total.min()
    return total / total.max()


def _along_line(image: np.ndarray, radius: int, sigma: float, angle: float) -> np.ndarray:
    """One-sided Gaussian blur of 2 `radius` + 1 pixels along a line at an angle."""
    steps = np.arange(2 * radius + 1)
    half = 2 * radius
    kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
    v, u = np.round(steps * np.sin(angle)).astype(int), np.round(steps * np.cos(angle)).astype(int)
    np.add.at(kernel, (half + v, half + u), np.exp(-(steps**2) / (2 * sigma**2)))
    return cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT)


COLOUR = {
    "gaussian noise": ImageChange(gaussian_noise, (0.08, 0.12, 0.18, 0.26, 0.38)),
    "shot noise": ImageChange(shot_noise, (60, 25, 12, 5, 3)),
    "impulse noise": ImageChange(impulse_noise, (0.03, 0.06, 0.09, 0.17, 0.27)),
    "speckle noise": ImageChange(speckle_noise, (0.15, 0.2, 0.35, 0.45, 0.6)),
    "gaussian blur": ImageChange(gaussian_blur, (1, 2, 3, 4, 6)),
    "defocus": ImageChange(defocus, ((3, 0.1), (4, 0.5), (6, 0.5), (8, 0.5), (10, 0.5))),
    "motion blur": ImageChange(motion_blur, ((10, 3), (15, 5), (15, 8), (15, 12), (20, 15))),
    "glass blur": ImageChange(glass_blur, ((0.7, 1, 2), (0.9, 2, 1), (1, 2, 3), (1.1, 3, 2), (1.5, 4, 2))),
    "brightness": ImageChange(brightness, (0.1, 0.2, 0.3, 0.4, 0.5)),
    "contrast": ImageChange(contrast, (0.4, 0.3, 0.2, 0.1, 0.05)),
    "fog": ImageChange(fog, ((1.5, 2), (2, 2), (2.5, 1.7), (2.5, 1.5), (3, 1.4))),
    "snow": ImageChange(
        snow,
        (
            (0.1, 0.3, 3, 0.5, 10, 4, 0.8),
            (0.2, 0.3, 2, 0.5, 12, 4, 0.7),
            (0.55, 0.3, 4, 0.9, 12, 8, 0.7),
            (0.55, 0.3, 4.5, 0.85, 12, 8, 0.65),
            (0.55, 0.3, 2.5, 0.85, 12, 12, 0.55),
        ),
    ),
    "jpeg": ImageChange(jpeg, (25, 18, 15, 10, 7)),
    "pixelate": ImageChange(pixelate, (0.6, 0.5, 0.4, 0.3, 0.25)),
}
"""Perturbations of colour images in [0, 1] by name."""
