"""The renderer: Gaussians and a camera to colour, depth and opacity."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float, Int

from sfgs_jax.geometry import Camera, InputError
from sfgs_jax.splatting.config import DEFAULT, RenderConfig
from sfgs_jax.splatting.gaussians import Gaussians
from sfgs_jax.splatting.projection import project
from sfgs_jax.splatting.rasterization import rasterize, require_rows, with_a_free_slot


class RenderOutput(eqx.Module):
    """What the camera sees.

    Attributes:
        rgb: (H, W, 3) colour over the background, not clipped above.
        depth: (H, W) expected depth along z, metres: `accumulated_depth / alpha`; 0 where nothing is.
        median_depth: (H, W) depth along z of the Gaussian in which half of the light is lost, metres; 0
            where more than half of it passes. Its gradient is that of that one Gaussian's depth.
        accumulated_depth: (H, W) sum of weights times depths, metres. Linear in the weights, so it has
            no quotient that a nearly empty pixel could blow up; GS-ICP-SLAM's depth loss is on it.
        alpha: (H, W) opacity, in [0, 1].
        features: (H, W, C) sum of weights times features, over nothing; None where none were given.
        overflow: (tile, Gaussian) pairs that found no room, 0 when the images are complete; see
            `pair_capacity`.
    """

    rgb: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    median_depth: Float[Array, "h w"]
    accumulated_depth: Float[Array, "h w"]
    alpha: Float[Array, "h w"]
    features: Float[Array, "h w c"] | None
    overflow: Int[Array, ""]


def render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None = None,
    colours: Float[Array, "n 3"] | None = None,
    features: Float[Array, "n c"] | None = None,
    *,
    config: RenderConfig = DEFAULT,
) -> RenderOutput:
    """Draw the Gaussians as the camera sees them.

    Reverse-mode differentiable in everything but `config`: the Gaussians' parameters, the intrinsics, the
    pose, the background, the colours and the features, through every image. For the gradient on the pose's
    tangent, differentiate `render(gaussians, camera, se3.compose(T_world_cam, se3.exp(delta)))` in `delta`
    at 0. There is no forward mode. For a batch of views, `vmap` over cameras and poses.

    Args:
        gaussians: the map.
        camera: intrinsics and image size; pixel centres lie at integer coordinates.
        T_world_cam: pose of the camera.
        background: (3,) RGB behind everything; black where None.
        colours: (N, 3) RGB of the Gaussians instead of that of their spherical harmonics.
        features: (N, C) what else to composite, any number of channels.
        config: settings, static.

    Raises:
        InputError: `sh`, `colours` or `features` have a shape that does not fit.
        TypeError: it is differentiated in forward mode.
    """
    count = gaussians.means.shape[0]
    if features is not None:
        require_rows("features", features, count)
    if colours is not None and colours.shape != (count, 3):
        raise InputError(f"colours have shape {colours.shape}; {count} Gaussians need ({count}, 3).")
    if count == 0:
        gaussians, colours, features = with_a_free_slot((gaussians, colours, features))
    try:
        return _render(gaussians, camera, T_world_cam, background, colours, features, config)
    except TypeError as error:
        if "custom_vjp" not in str(error):
            raise
        raise TypeError(
            "render has no forward-mode derivative (jvp, jacfwd, linearize); "
            "use reverse mode: grad, vjp or jacrev."
        ) from error


# Compiled here, because operation by operation it would take minutes; inside a caller's jit this is inlined.
@partial(jax.jit, static_argnames="config")
def _render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None,
    colours: Float[Array, "n 3"] | None,
    features: Float[Array, "n c"] | None,
    config: RenderConfig,
) -> RenderOutput:
    projected, rgb = project(gaussians, camera, T_world_cam, config=config)
    columns = [rgb if colours is None else colours, projected.depths[:, None]]
    raster = rasterize(
        projected,
        jnp.concatenate(columns if features is None else [*columns, features], axis=-1),
        width=camera.width,
        height=camera.height,
        config=config,
    )
    colour, accumulated, alpha = raster.accumulated[..., :3], raster.accumulated[..., 3], raster.alpha
    if background is not None:
        colour = colour + (1 - alpha)[..., None] * background
    hit = alpha > 0
    return RenderOutput(
        rgb=colour,
        depth=jnp.where(hit, accumulated, 0) / jnp.where(hit, alpha, 1),
        median_depth=jnp.where(raster.median >= 0, projected.depths[jnp.maximum(raster.median, 0)], 0),
        accumulated_depth=accumulated,
        alpha=alpha,
        features=None if features is None else raster.accumulated[..., 4:],
        overflow=raster.overflow,
    )
