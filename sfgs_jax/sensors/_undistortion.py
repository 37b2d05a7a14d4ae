"""Undistortion of a pair of registered images."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.geometry import Camera


class Undistortion:
    """Undistortion: draws colour and depth as a pinhole camera of the same intrinsics would have seen them.

    The images are black and without depth beyond the lens's field of view.

    Attributes:
        valid: (h, w) pixels within it; the others have no colour.
    """

    valid: Bool[np.ndarray, "h w"]

    def __init__(self, camera: Camera, coefficients: Sequence[float]) -> None:
        """Prepare for images of the camera's size.

        Args:
            camera: intrinsics, before and after.
            coefficients: k1, k2, p1, p2 of OpenCV's lens model, then k3, or k3 to k6.
        """
        matrix = np.asarray(camera.matrix(), np.float64)
        self._shape = camera.shape
        self._columns, self._rows = cv2.initUndistortRectifyMap(
            matrix, np.asarray(coefficients), None, matrix, self._shape[::-1], cv2.CV_32FC1
        )
        height, width = self._shape
        # A pixel between the outermost ones and the black has some of it.
        self.valid = (
            (self._columns >= 0)
            & (self._columns <= width - 1)
            & (self._rows >= 0)
            & (self._rows <= height - 1)
        )

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """The pair without the lens; a pair of another size than the camera's comes back as it is.

        Args:
            rgb: (h, w, 3) colour.
            depth: (h, w) metres, 0 where missing.
        """
        if rgb.shape[:2] != self._shape or depth.shape != self._shape:
            # The caller checks the size of the frame that it asked for, and has a sentence for it.
            return rgb, depth
        # Between two depths lies no surface, so depth is taken from the nearest pixel.
        return (
            cv2.remap(rgb, self._columns, self._rows, cv2.INTER_LINEAR),
            cv2.remap(depth, self._columns, self._rows, cv2.INTER_NEAREST),
        )
