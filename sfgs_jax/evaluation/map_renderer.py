"""A map with a camera, rendered at pose after pose."""

import equinox as eqx
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting import Gaussians, RenderConfig, RenderOutput, render


class MapRenderer:
    """Renders a map at poses given on the host, with as much room for pairs as the views turn out to need."""

    def __init__(self, gaussians: Gaussians, camera: Camera) -> None:
        self._gaussians, self._camera = gaussians, camera
        self._pair_capacity = RenderConfig().pair_capacity

    def __call__(self, T_world_cam: Float[np.ndarray, "4 4"]) -> RenderOutput:
        """The whole image at a pose; a view that needs more room than any before compiles anew."""
        pose = se3.from_matrix(T_world_cam)
        while True:
            config = RenderConfig(pair_capacity=self._pair_capacity)
            output = _render(self._gaussians, self._camera, pose, config)
            missing = int(output.overflow)
            if not missing:
                return output
            # A power of two leaves room for the next views, so that few of them compile anew.
            self._pair_capacity = 1 << (self._pair_capacity + missing).bit_length()


@eqx.filter_jit
def _render(
    gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, config: RenderConfig
) -> RenderOutput:
    return render(gaussians, camera, T_world_cam, config=config)
