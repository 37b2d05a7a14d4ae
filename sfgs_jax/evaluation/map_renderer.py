"""A map with a camera, rendered at pose after pose."""

import equinox as eqx
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, RenderOutput, pair_capacity, render

# Views differ: with this much more room than the first one needs, few of the others compile anew.
_HEADROOM = 1.3


class MapRenderer:
    """Renders a map at poses given on the host, with as much room for pairs as the views turn out to need."""

    def __init__(self, gaussians: Gaussians, camera: Camera) -> None:
        self._gaussians, self._camera = gaussians, camera
        self._config: RenderConfig | None = None

    def __call__(self, T_world_cam: Float[np.ndarray, "4 4"]) -> RenderOutput:
        """The whole image at a pose; a view that needs more room than those before compiles anew."""
        pose = se3.from_matrix(T_world_cam)
        self._config = self._config or self._room_for(pose)
        output = _render(self._gaussians, self._camera, pose, self._config)
        if int(output.overflow):
            self._config = self._room_for(pose)
            output = _render(self._gaussians, self._camera, pose, self._config)
        return output

    def _room_for(self, pose: jaxlie.SE3) -> RenderConfig:
        need = pair_capacity(self._gaussians, self._camera, pose, headroom=_HEADROOM)
        return RenderConfig(pair_capacity=need)


@eqx.filter_jit
def _render(
    gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, config: RenderConfig
) -> RenderOutput:
    return render(gaussians, camera, T_world_cam, config=config)
