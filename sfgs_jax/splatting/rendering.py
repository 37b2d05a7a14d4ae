"""The renderer: Gaussians and a camera to colour, depth and opacity."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float, Int

from sfgs_jax.geometry import Camera
from sfgs_jax.splatting.config import DEFAULT, RenderConfig
from sfgs_jax.splatting.gaussians import Gaussians
from sfgs_jax.splatting.projection import project
from sfgs_jax.splatting.rasterization import rasterize


class RenderOutput(eqx.Module):
    """What the camera sees.

    Attributes:
        rgb: (H, W, 3) colour over the background, not clipped above.
        depth: (H, W) expected depth along z, metres: `accumulated_depth / alpha`; 0 where nothing is.
        alpha: (H, W) opacity, in [0, 1].
        accumulated_depth: (H, W) sum of weights times depths, metres. Linear in the weights, so it has
            no quotient that a nearly empty pixel could blow up; GS-ICP-SLAM's depth loss is on it.
        overflow: (tile, Gaussian) pairs that found no room, 0 when the images are complete; see
            `pair_capacity`.
    """

    rgb: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    alpha: Float[Array, "h w"]
    accumulated_depth: Float[Array, "h w"]
    overflow: Int[Array, ""]


def render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None = None,
    *,
    config: RenderConfig = DEFAULT,
) -> RenderOutput:
    """Draw the Gaussians as the camera sees them.

    Reverse-mode differentiable in the Gaussians' parameters, the intrinsics, the pose and the background,
    through colour, depth and opacity. For the gradient on the pose's tangent, differentiate
    `render(gaussians, camera, se3.compose(T_world_cam, se3.exp(delta)))` in `delta` at 0.

    Args:
        gaussians: the map.
        camera: intrinsics and image size; pixel centres lie at integer coordinates.
        T_world_cam: pose of the camera.
        background: (3,) RGB behind everything; black where None.
        config: settings, static.
    """
    return _render(gaussians, camera, T_world_cam, background, config)


# Compiled here, because operation by operation it would take minutes; inside a caller's jit this is inlined.
@partial(jax.jit, static_argnames="config")
def _render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None,
    config: RenderConfig,
) -> RenderOutput:
    projected, rgb = project(gaussians, camera, T_world_cam, config=config)
    features = jnp.concatenate([rgb, projected.depths[:, None]], axis=-1)
    image, alpha, overflow = rasterize(
        projected, features, width=camera.width, height=camera.height, config=config
    )
    colour, accumulated = image[..., :3], image[..., 3]
    if background is not None:
        colour = colour + (1 - alpha)[..., None] * background
    hit = alpha > 0
    return RenderOutput(
        rgb=colour,
        depth=jnp.where(hit, accumulated, 0) / jnp.where(hit, alpha, 1),
        alpha=alpha,
        accumulated_depth=accumulated,
        overflow=overflow,
    )
