"""Registration of depth from a camera of its own."""

import cv2
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets.files._file_recording import size_text
from sfgs_jax.geometry import Camera, register_depth, se3
from sfgs_jax.sensors import Undistortion


class DepthRegistration:
    """Draws depth into the colour camera's view."""

    def __init__(
        self,
        depth_camera: Camera,
        camera: Camera,
        T_camera_depth: Float[np.ndarray, "4 4"],
        *,
        colour_size: tuple[int, int] | None = None,
        undistortion: Undistortion | None = None,
    ) -> None:
        """Prepare for images of fixed sizes.

        Args:
            depth_camera: camera of the depth images.
            camera: camera to register to.
            T_camera_depth: depth camera coordinates to camera coordinates.
            colour_size: width and height at which colour is stored, if it is to be scaled to the camera's.
            undistortion: takes the lens out of colour at the camera's size.
        """
        self._depth_camera = depth_camera
        self._camera = camera
        self._T_camera_depth = se3.from_matrix(T_camera_depth)
        self._colour_size = colour_size or (camera.width, camera.height)
        self._undistortion = undistortion
        self.valid = None if undistortion is None else undistortion.valid

    def __call__(
        self, rgb: Float[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h2 w2"]
    ) -> tuple[Float[np.ndarray, "h3 w3 3"], Float[np.ndarray, "h3 w3"]]:
        """Colour and depth as the camera sees them. Raises FrameError for images of other sizes."""
        if depth.shape != self._depth_camera.shape or rgb.shape[:2] != self._colour_size[::-1]:
            expected = "x".join(map(str, self._colour_size))
            raise FrameError(
                f"Colour is {size_text(rgb)} and depth {size_text(depth)}, other than the first frame's "
                f"{expected} and {self._depth_camera.width}x{self._depth_camera.height}."
            )
        size = (self._camera.width, self._camera.height)
        if self._colour_size != size:
            rgb = np.asarray(cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), np.float32)
        registered = np.asarray(
            register_depth(jnp.asarray(depth), self._depth_camera, self._camera, self._T_camera_depth)
        )
        if self._undistortion is not None:
            # Registered depth is a pinhole camera's already.
            rgb = self._undistortion(rgb, registered)[0]
        return rgb, registered
