"""Pairs of images with a known relative pose or homography."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.datasets.files import decode_colour


@dataclass(frozen=True)
class PosePair:
    """Two photographs of one scene with calibrated cameras.

    Attributes:
        name: for tables and messages.
        image_a: file of image a.
        image_b: file of image b.
        K_a: calibration matrix of image a at the file's size.
        K_b: calibration matrix of image b at the file's size.
        T_b_a: takes camera coordinates of a to those of b; its translation may have any unit.
    """

    name: str
    image_a: Path
    image_b: Path
    K_a: Float[np.ndarray, "3 3"]
    K_b: Float[np.ndarray, "3 3"]
    T_b_a: Float[np.ndarray, "4 4"]

    def load(
        self, *, longest: int | None = None
    ) -> tuple[
        tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h2 w2 3"]],
        tuple[Float[np.ndarray, "3 3"], Float[np.ndarray, "3 3"]],
    ]:
        """Both images, RGB in [0, 1], and their calibration matrices.

        Args:
            longest: shrink an image whose longer side is above this many pixels.

        Raises:
            FrameError: an image can't be read.
        """
        (a, scale_a), (b, scale_b) = (_load(path, longest) for path in (self.image_a, self.image_b))
        return (a, b), (scale_a @ self.K_a, scale_b @ self.K_b)


@dataclass(frozen=True)
class HomographyPair:
    """Two photographs of a plane, or of anything from one place.

    Attributes:
        name: for tables and messages.
        group: the difference between the images, such as "viewpoint" or "illumination".
        image_a: file of image a.
        image_b: file of image b.
        H_b_a: takes pixels (u, v) of a to those of b, both at the files' sizes.
    """

    name: str
    group: str
    image_a: Path
    image_b: Path
    H_b_a: Float[np.ndarray, "3 3"]

    def load(
        self, *, longest: int | None = None
    ) -> tuple[tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h2 w2 3"]], Float[np.ndarray, "3 3"]]:
        """Both images, RGB in [0, 1], and the homography between them; as `PosePair.load`."""
        (a, scale_a), (b, scale_b) = (_load(path, longest) for path in (self.image_a, self.image_b))
        H_b_a = scale_b @ self.H_b_a @ np.linalg.inv(scale_a)
        return (a, b), H_b_a / H_b_a[2, 2]


def _load(path: Path, longest: int | None) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "3 3"]]:
    """The image, and the homography from pixels of the file to its pixels."""
    image = decode_colour(path)
    height, width = image.shape[:2]
    if longest is None or max(height, width) <= longest:
        return image, np.eye(3)
    factor = longest / max(height, width)
    size = max(1, round(width * factor)), max(1, round(height * factor))
    u, v = size[0] / width, size[1] / height
    # Pixel centres lie at integers, so the image's corner is at (-0.5, -0.5) before and after.
    scale = np.array([[u, 0, 0.5 * u - 0.5], [0, v, 0.5 * v - 0.5], [0, 0, 1]])
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.float32), scale
