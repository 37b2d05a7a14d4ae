"""Taking the lens out of a pair of registered images."""

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera


class Undistortion:
    """Draws colour and depth as a pinhole camera of the same intrinsics would have seen them.

    Where the lens saw nothing of what the pinhole camera would see, the images are black and without depth.
    """

    def __init__(self, camera: Camera, coefficients: Sequence[float]) -> None:
        """Prepare for images of the camera's size.

        Args:
            camera: intrinsics, before and after.
            coefficients: of OpenCV's model: k1, k2, p1, p2, then k3, or k3 to k6.
        """
        matrix = np.asarray(camera.matrix(), np.float64)
        self._shape = camera.shape
        self._columns, self._rows = cv2.initUndistortRectifyMap(
            matrix, np.asarray(coefficients), None, matrix, self._shape[::-1], cv2.CV_32FC1
        )

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w"]]:
        """The pair without the lens."""
        if rgb.shape[:2] != self._shape or depth.shape != self._shape:
            # Whoever asked for the frame says that it is of another size.
            return rgb, depth
        # Between two depths lies no surface, so depth is taken from the nearest pixel.
        return (
            cv2.remap(rgb, self._columns, self._rows, cv2.INTER_LINEAR),
            cv2.remap(depth, self._columns, self._rows, cv2.INTER_NEAREST),
        )
