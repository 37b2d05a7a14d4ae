"""Images of a map from the library's own renderer."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting import Gaussians, Renderer, RenderOutput
from sfgs_jax.viewer._map_layer import certainty_colours
from sfgs_jax.viewer._modes import Look, depth_range, normal_colours, turbo
from sfgs_jax.viewer._splats import Splats, sampled, sampled_gaussians

_HEADROOM = 1.5
"""Factor on the first view's need of pairs: a compilation takes longer than many views."""

OPAQUE = 0.5
"""Opacity from which on a pixel has a depth."""

_POINT_SIGMA = 0.3
"""Standard deviation of a point, in those of a middling Gaussian."""

_SOLID = 8.0
"""Logit of a point's opacity."""


class Painter:
    """Renders a map as the page draws it; compiles once for each image size.

    Args:
        gaussians: the map.
        splats: the same in the browser's form.
        axes: rows: right, forward and up.
        keyframes: cameras that the map was made from; may be empty.
        camera: their intrinsics; None if they are not known.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        splats: Splats,
        axes: Float[np.ndarray, "3 3"],
        keyframes: Trajectory,
        camera: Camera | None,
    ) -> None:
        self._gaussians, self._splats, self._axes = gaussians, splats, axes
        self._keyframes, self._camera = keyframes, camera
        self._drawn: tuple[Look, Gaussians, Array | None] | None = None
        self._renderers: dict[tuple[int, int], Renderer] = {}

    def sampled(self, most: int) -> "Painter":
        """A painter of a sample of so many Gaussians, enlarged to fill the gaps; itself if it has fewer."""
        if len(self._splats) <= most:
            return self
        gaussians, splats = sampled_gaussians(self._gaussians, most), sampled(self._splats, most)
        return Painter(gaussians, splats, self._axes, self._keyframes, self._camera)

    def shown(self, look: Look) -> Gaussians:
        """The Gaussians that a look leaves, unchanged; the others are no longer valid."""
        used = np.asarray(self._gaussians.valid)
        valid = np.zeros(len(used), bool)
        valid[used] = look.shown(self._splats.centres, self._splats.opacities[:, 0])
        return dataclasses.replace(self._gaussians, valid=jnp.asarray(valid))

    def render(
        self,
        T_world_cam: Float[np.ndarray, "4 4"],
        camera: Camera,
        look: Look,
        *,
        background: Float[np.ndarray, "3"],
        shutter: RollingShutter | None = None,
    ) -> RenderOutput:
        """The map from a pose.

        Args:
            T_world_cam: pose of the camera.
            camera: intrinsics and size of the image.
            look: what to draw.
            background: RGB in [0, 1] behind the map.
            shutter: motion of the camera while the rows are exposed; None for an image taken at once.
        """
        gaussians, colours = self._prepared(look)
        pose, behind = se3.from_matrix(T_world_cam), jnp.asarray(background, jnp.float32)
        renderer = self._renderers.setdefault(camera.shape, Renderer(headroom=_HEADROOM))
        return renderer(gaussians, camera, pose, behind, colours, shutter=shutter)

    def paint(
        self,
        T_world_cam: Float[np.ndarray, "4 4"],
        camera: Camera,
        look: Look,
        *,
        background: Float[np.ndarray, "3"],
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The same as an image of bytes; depth in Turbo colours, red near and blue far."""
        output = jax.device_get(self.render(T_world_cam, camera, look, background=background))
        return picture_of(output, look, background=background)

    def _prepared(self, look: Look) -> tuple[Gaussians, Array | None]:
        """Gaussians and colours of a look; None are the map's own."""
        drawn = self._drawn
        if drawn is None or drawn[0] is not look:
            # Threads with other looks may come in between.
            self._drawn = drawn = (look, self._resized(look), self._coloured(look))
        return drawn[1:]

    def _resized(self, look: Look) -> Gaussians:
        shown = self.shown(look)
        if look.mode != "points" or not len(self._splats):
            return dataclasses.replace(shown, log_scales=shown.log_scales + jnp.float32(np.log(look.size)))
        sigma = np.sqrt(np.median(np.trace(self._splats.covariances, axis1=1, axis2=2)) / 3)
        size = np.log(_POINT_SIGMA * look.size * sigma)
        return dataclasses.replace(
            shown,
            log_scales=jnp.full_like(shown.log_scales, size),
            opacity_logits=jnp.full_like(shown.opacity_logits, _SOLID),
        )

    def _coloured(self, look: Look) -> Array | None:
        if look.mode == "normals":
            found = normal_colours(self._splats, self._axes)
        elif look.mode == "uncertainty":
            found, _ = certainty_colours(self._splats, self._keyframes, self._camera)
        else:
            return None
        used = np.asarray(self._gaussians.valid)
        colours = np.zeros((len(used), 3), np.float32)
        colours[used] = found
        return jnp.asarray(colours)


def picture_of(
    output: RenderOutput, look: Look, *, background: Float[np.ndarray, "3"]
) -> UInt8[np.ndarray, "H W 3"]:
    """What a look shows of a rendering.

    Args:
        output: from `Painter.render`, on the host.
        look: that it was rendered with.
        background: RGB in [0, 1] behind the map.
    """
    if look.mode == "depth":
        return depth_picture(np.where(output.alpha > OPAQUE, output.depth, 0), background=background)
    return bytes_of(np.asarray(output.rgb))


def bytes_of(rgb: Float[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
    """Colours in [0, 1] as bytes."""
    return np.round(255 * np.clip(rgb, 0, 1)).astype(np.uint8)


def depth_picture(
    depth: Float[np.ndarray, "H W"],
    *,
    background: Float[np.ndarray, "3"],
    limits: tuple[float, float] | None = None,
) -> UInt8[np.ndarray, "H W 3"]:
    """Depth in Turbo colours, red near and blue far.

    Args:
        depth: metres, 0 where missing.
        background: RGB in [0, 1] where it is missing.
        limits: depths of the first and the last colour, metres; None takes them from the image.
    """
    near, far = depth_range(depth) if limits is None else limits
    colours = turbo((depth - near) / (far - near))
    return np.where((depth > 0)[..., None], colours, bytes_of(background)).astype(np.uint8)
