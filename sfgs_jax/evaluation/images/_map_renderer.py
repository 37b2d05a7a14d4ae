"""Rendering of a map at one pose after another."""

from functools import partial

import jax
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting import Gaussians, RenderConfig, RenderOutput, pair_capacity, render

# Views differ. With this much more room than the first view needs, few of the others compile anew.
_HEADROOM = 1.3


class MapRenderer:
    """Renders a map at poses given on the host; the room for pairs grows when a view needs more.

    Args:
        gaussians: the map.
        camera: intrinsics of the images.
    """

    def __init__(self, gaussians: Gaussians, camera: Camera) -> None:
        self._gaussians, self._camera = gaussians, camera
        self._config: RenderConfig | None = None

    def __call__(
        self, T_world_cam: Float[np.ndarray, "4 4"], shutter: RollingShutter | None = None
    ) -> RenderOutput:
        """The whole image at a pose; a view that needs more room than the earlier ones compiles anew.

        Args:
            T_world_cam: pose of the camera.
            shutter: its motion while the rows are exposed; None for an image taken at once.
        """
        pose = se3.from_matrix(T_world_cam)
        self._config = self._config or self._room_for(pose)
        output = _render(self._gaussians, self._camera, pose, shutter, self._config)
        if int(output.overflow):
            self._config = self._room_for(pose)
            output = _render(self._gaussians, self._camera, pose, shutter, self._config)
        return output

    def _room_for(self, pose: jaxlie.SE3) -> RenderConfig:
        need = pair_capacity(self._gaussians, self._camera, pose, headroom=_HEADROOM)
        return RenderConfig(pair_capacity=need)


@partial(jax.jit, static_argnames=("config",))
def _render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    shutter: RollingShutter | None,
    config: RenderConfig,
) -> RenderOutput:
    return render(gaussians, camera, T_world_cam, shutter=shutter, config=config)
