"""The newest frame beside the map's render from its pose, and their difference."""

from dataclasses import dataclass
from functools import partial

import cv2
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from sfgs_jax.evaluation import psnr_by_protocol
from sfgs_jax.geometry import Camera, Frame, downscale_depth, downscale_rgb, se3
from sfgs_jax.sensors import with_gain
from sfgs_jax.slam import SlamState
from sfgs_jax.splatting import Gaussians, RenderConfig, render

_OPAQUE = 0.5
"""Opacity from which the map has a depth."""

_BRIGHTEST_DIFFERENCE = 0.4
"""Mean difference of the channels that is drawn brightest."""

_TILE_WIDTH = 320
"""Width that one of the four images has about, pixels."""

_FONT, _FONT_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.55


_MAX_WIDTH = 320
"""Largest width of the compared images, pixels."""


@dataclass(frozen=True)
class Comparison:
    """A frame beside the map's render of it.

    Attributes:
        picture: recording and render in the upper row, their difference and the rendered depth in the lower.
        psnr: of the pixels with recorded depth, dB.
    """

    picture: UInt8[np.ndarray, "H W 3"]
    psnr: float


def compare(state: SlamState, frame: Frame) -> Comparison:
    """Render the map at the newest pose, in a size that the page has room for.

    A map that has grown, or needs more room for pairs, compiles anew.

    Args:
        state: with the frame as its newest, and at least one tracked frame.
        frame: the frame.
    """
    gains = state.gains
    factor = max(1, -(-state.camera.width // _MAX_WIDTH))
    compared = _compared(
        state.mapping.map.gaussians,
        state.camera.downscaled(factor),
        se3.from_matrix(state.trajectory.poses[-1]),
        jnp.asarray(frame.rgb, jnp.float32),
        jnp.asarray(frame.depth, jnp.float32),
        jnp.asarray(np.ones(3) if gains is None else gains[-1], jnp.float32),
        RenderConfig(pair_capacity=state.mapping.pair_capacity),
    )
    images = (np.asarray(image) for image in compared[:3])
    return Comparison(_picture(*images, complete=not compared[4]), float(compared[3]))


@partial(jax.jit, static_argnames=("config",))
def _compared(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    rgb: Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    gain: Float[Array, "3"],
    config: RenderConfig,
) -> tuple[
    Float[Array, "h w 3"], Float[Array, "h w 3"], Float[Array, "h w"], Float[Array, ""], Int[Array, ""]
]:
    """The recorded image reduced, the rendered one and its depth, the PSNR, and pairs without room."""
    factor = rgb.shape[1] // camera.width
    rgb, depth = downscale_rgb(rgb, factor), downscale_depth(depth, factor)
    seen = render(gaussians, camera, T_world_cam, config=config)
    rendered = jnp.clip(with_gain(seen.rgb, gain), 0, 1)
    psnr = psnr_by_protocol(rendered, rgb, depth, jnp.ones(depth.shape, bool))["depth"]
    return rgb, rendered, jnp.where(seen.alpha > _OPAQUE, seen.depth, 0), psnr, seen.overflow


def _picture(
    rgb: Float[np.ndarray, "h w 3"],
    rendered: Float[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "h w"],
    *,
    complete: bool,
) -> UInt8[np.ndarray, "H W 3"]:
    difference = np.abs(rendered - rgb).mean(axis=2) / _BRIGHTEST_DIFFERENCE
    near, far = np.percentile(depth[depth > 0], [2, 98]) if np.any(depth > 0) else (0.0, 1.0)
    share = np.where(depth > 0, np.clip((depth - near) / max(far - near, 1e-3), 0.01, 1), 0)
    tiles = [
        _titled(_eight_bits(rgb), "recorded"),
        _titled(_eight_bits(rendered), "rendered" if complete else "rendered in part"),
        _titled(_coloured(difference, cv2.COLORMAP_INFERNO), "difference"),
        _titled(_coloured(share, cv2.COLORMAP_TURBO), f"depth, {near:.1f} to {far:.1f} m"),
    ]
    return np.vstack([np.hstack(tiles[:2]), np.hstack(tiles[2:])])


def _eight_bits(values: Float[np.ndarray, "*shape"]) -> UInt8[np.ndarray, "*shape"]:
    return np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)


def _coloured(values: Float[np.ndarray, "h w"], colour_map: int) -> UInt8[np.ndarray, "h w 3"]:
    """Colours of values in [0, 1]; black where they are zero."""
    coloured = cv2.applyColorMap(_eight_bits(values), colour_map)[..., ::-1]
    return np.where(values[..., None] > 0, coloured, np.uint8(0))


def _titled(image: UInt8[np.ndarray, "h w 3"], title: str) -> UInt8[np.ndarray, "H W 3"]:
    """The image, enlarged if it is small, with a title in its corner."""
    scale = max(1, round(_TILE_WIDTH / image.shape[1]))
    image = np.ascontiguousarray(np.repeat(np.repeat(image, scale, axis=0), scale, axis=1))
    (width, height), _ = cv2.getTextSize(title, _FONT, _FONT_SCALE, 1)
    image[: height + 16, : width + 16] //= 4
    cv2.putText(image, title, (8, height + 8), _FONT, _FONT_SCALE, (255, 255, 255), 1, cv2.LINE_AA)
    return image
