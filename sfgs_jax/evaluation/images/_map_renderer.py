"""Rendering of a map at one pose after another."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting import Gaussians, Renderer, RenderOutput, with_background


class MapRenderer:
    """Renders a map at poses given on the host.

    Args:
        gaussians: the map.
        camera: intrinsics of the images.
        background: (9, 3) colours behind the map, see `splatting.fitted_background`; black where None.
    """

    def __init__(
        self, gaussians: Gaussians, camera: Camera, background: Float[np.ndarray, "9 3"] | None = None
    ) -> None:
        self._gaussians, self._camera = gaussians, camera
        self._background = None if background is None else jnp.asarray(background, jnp.float32)
        self._render = Renderer()

    def __call__(
        self, T_world_cam: Float[np.ndarray, "4 4"], shutter: RollingShutter | None = None
    ) -> RenderOutput:
        """The whole image at a pose; a view that needs more room than the earlier ones compiles anew.

        Args:
            T_world_cam: pose of the camera.
            shutter: its motion while the rows are exposed; None for an image taken at once.
        """
        output = self._render(self._gaussians, self._camera, T_world_cam, shutter=shutter)
        if self._background is None:
            return output
        return with_background(output, self._background, self._camera, jnp.asarray(T_world_cam, jnp.float32))
