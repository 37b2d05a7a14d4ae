"""A renderer that makes room: pairs that do not fit are counted, and the view is drawn again with more."""

from dataclasses import replace

from jaxtyping import Array, Float

from sfgs_jax.arrays import InputError, is_known
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting._capacity import pair_capacity
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting._rendering import RenderOutput, render


class Renderer:
    """Draws one view after another on the host; the room for pairs grows when a view needs more.

    The first view, and each that needs more room than those before it, compile a program. Inside `jit` or
    `grad` take `render` with a renderer's `config`, and let `make_room` enlarge it where `overflow` is not 0.

    Args:
        config: settings; its `pair_capacity` has no influence.
        headroom: factor on a view's need, so that few of the next views need more.

    Attributes:
        config: settings with the room of the views so far.

    Raises:
        InputError: the headroom is below 1.
    """

    def __init__(self, config: RenderConfig = DEFAULT, *, headroom: float = 1.3) -> None:
        if not headroom >= 1:
            raise InputError(f"The headroom is a factor of at least 1, not {headroom}.")
        self.config = replace(config, pair_capacity=1)
        self._headroom = headroom

    def __call__(
        self,
        gaussians: Gaussians,
        camera: Camera,
        T_world_cam: se3.Pose,
        background: Float[Array, "3"] | None = None,
        colours: Float[Array, "n 3"] | None = None,
        features: Float[Array, "n c"] | None = None,
        *,
        shutter: RollingShutter | None = None,
    ) -> RenderOutput:
        """The complete images of a view; arguments and errors are those of `render`.

        Raises:
            InputError: an argument does not fit, or is traced.
        """
        inputs = gaussians, camera, T_world_cam, background, colours, features
        if self.config.pair_capacity == 1:
            self.make_room(gaussians, camera, T_world_cam)
        output = render(*inputs, shutter=shutter, config=self.config)
        if not is_known(output.overflow):
            raise InputError("A Renderer works on the host: inside jit or grad use render with its config.")
        while int(output.overflow):
            self.make_room(gaussians, camera, T_world_cam, at_least=2 * self.config.pair_capacity)
            output = render(*inputs, shutter=shutter, config=self.config)
        return output

    def make_room(
        self, gaussians: Gaussians, camera: Camera, T_world_cam: se3.Pose, *, at_least: int = 1
    ) -> RenderConfig:
        """Enlarge the room to what a view needs, and return the settings; room never shrinks.

        Args:
            gaussians: the map.
            camera: intrinsics and image size.
            T_world_cam: pose of the camera.
            at_least: least room.
        """
        need = pair_capacity(gaussians, camera, T_world_cam, config=self.config, headroom=self._headroom)
        room = max(need, at_least, self.config.pair_capacity)
        self.config = replace(self.config, pair_capacity=room)
        return self.config
