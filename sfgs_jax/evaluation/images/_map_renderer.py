"""Rendering of a map at one pose after another."""

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting import Gaussians, Renderer, RenderOutput


class MapRenderer:
    """Renders a map at poses given on the host.

    Args:
        gaussians: the map.
        camera: intrinsics of the images.
    """

    def __init__(self, gaussians: Gaussians, camera: Camera) -> None:
        self._gaussians, self._camera = gaussians, camera
        self._render = Renderer()

    def __call__(
        self, T_world_cam: Float[np.ndarray, "4 4"], shutter: RollingShutter | None = None
    ) -> RenderOutput:
        """The whole image at a pose; a view that needs more room than the earlier ones compiles anew.

        Args:
            T_world_cam: pose of the camera.
            shutter: its motion while the rows are exposed; None for an image taken at once.
        """
        return self._render(self._gaussians, self._camera, T_world_cam, shutter=shutter)
