"""The renderer: from Gaussians and a camera to colour, depth and opacity."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import InputError, checked_but
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._gaussians import Gaussians, require_scene
from sfgs_jax.splatting._projection import project
from sfgs_jax.splatting._rasterization import rasterize, require_rows, with_a_free_slot
from sfgs_jax.splatting._surface_depth import surface_depth_of, surface_features
from sfgs_jax.splatting._visibility import occluder_of


class RenderOutput(eqx.Module):
    """Images that the camera sees.

    Attributes:
        rgb: (H, W, 3) colour over the background, not clipped above.
        depth: (H, W) expected depth along z, metres: `accumulated_depth / alpha`; 0 where alpha is 0.
        median_depth: (H, W) depth along z of the Gaussian at which the transmittance falls to one half,
            metres; 0 where it stays above. The gradient is this one Gaussian's.
        accumulated_depth: (H, W) sum of weights times depths, metres. It is linear in the weights, so nearly
            empty pixels do not blow it up; GS-ICP-SLAM's depth loss is on it.
        alpha: (H, W) opacity, in [0, 1].
        features: (H, W, C) sum of weights times features, without a background; None if none were given.
        overflow: number of (tile, Gaussian) pairs that found no room, 0 when the images are complete; the
            function `pair_capacity` tells how much room a view needs.
        needed: room for pairs that the images need, at least so much where some found none.
        surface_depth: (H, W) depth along z where the pixel's ray meets the surfaces, metres. It is the
            weighted harmonic mean of the Gaussians' depths at the pixel, 0 where alpha is 0. On a plane of
            flat Gaussians it is the plane's depth. None unless the settings ask for it.
    """

    rgb: Float[Array, "h w 3"]
    depth: Float[Array, "h w"]
    median_depth: Float[Array, "h w"]
    accumulated_depth: Float[Array, "h w"]
    alpha: Float[Array, "h w"]
    features: Float[Array, "h w c"] | None
    overflow: Int[Array, ""]
    needed: Int[Array, ""]
    surface_depth: Float[Array, "h w"] | None = None


@checked_but("gaussians", "camera", "T_world_cam")
def render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: se3.Pose,
    background: Float[Array, "3"] | None = None,
    colours: Float[Array, "n 3"] | None = None,
    features: Float[Array, "n c"] | None = None,
    *,
    shutter: RollingShutter | None = None,
    hidden_beyond: Float[Array, "H W"] | None = None,
    config: RenderConfig = DEFAULT,
) -> RenderOutput:
    """Draw the Gaussians as the camera sees them.

    Reverse-mode differentiable once, through every image and in every argument but `config`. There is no
    forward mode (`jvp`, `jacfwd`) and no second derivative. For the gradient by a whole `Gaussians` use
    `equinox.filter_grad`. For the gradient by the pose, differentiate
    `render(gaussians, camera, se3.compose(T_world_cam, se3.exp(delta)))` by `delta` at 0. For a batch of
    views, `vmap` over cameras and poses.

    Args:
        gaussians: the map.
        camera: intrinsics and image size; pixel centres lie at integer coordinates.
        T_world_cam: pose of the camera, `jaxlie.SE3` or a homogeneous 4 x 4 matrix.
        background: (3,) RGB behind everything; black where None.
        colours: (N, 3) RGB of the Gaussians, in place of their spherical harmonics.
        features: (N, C) further values to composite, any number of channels.
        shutter: motion of the camera while its rows are exposed; the pose is that of the middle row. None for
            an image taken at once.
        hidden_beyond: (H, W) depth along z, metres, behind which the camera sees nothing: that of a depth
            image, with a margin; 0 where it is unknown. A tile leaves out the Gaussians that lie behind the
            farthest of its pixels, which saves their time. Nothing is hidden if not given.
        config: settings, static.

    Raises:
        InputError: `sh`, `colours` or `features` have a shape that does not fit, or the pose is none.
        TypeError: the rendering is differentiated in forward mode.
    """
    require_scene(gaussians, camera)
    pose = se3.as_se3(T_world_cam, name="T_world_cam")
    count = gaussians.means.shape[0]
    if features is not None:
        require_rows("features", features, count)
    if colours is not None and colours.shape != (count, 3):
        raise InputError(f"colours have shape {colours.shape}; {count} Gaussians need ({count}, 3).")
    if count == 0:
        gaussians, colours, features = with_a_free_slot((gaussians, colours, features))
    try:
        return _render(
            gaussians, camera, pose, background, colours, features, shutter, hidden_beyond, config=config
        )
    except TypeError as error:
        if "custom_vjp" not in str(error):
            raise
        raise TypeError(
            "render has no forward-mode derivative (jvp, jacfwd, linearize); "
            "use reverse mode: grad, vjp or jacrev."
        ) from error


# Compiled here: operation by operation it would take minutes. Inside a caller's jit it is inlined.
@partial(jax.jit, static_argnames="config")
def _render(
    gaussians: Gaussians,
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    background: Float[Array, "3"] | None,
    colours: Float[Array, "n 3"] | None,
    features: Float[Array, "n c"] | None,
    shutter: RollingShutter | None,
    hidden_beyond: Float[Array, "H W"] | None,
    *,
    config: RenderConfig,
) -> RenderOutput:
    projected, rgb = project(gaussians, camera, T_world_cam, shutter, config=config)
    columns = [rgb if colours is None else colours, projected.depths[:, None]]
    slopes, middle = projected.inverse_depth_slopes, ((camera.width - 1) / 2, (camera.height - 1) / 2)
    if features is not None:
        columns.append(features)
    if slopes is not None:
        columns.append(surface_features(projected.centres, projected.depths, slopes, middle))
    occluder = None if hidden_beyond is None else occluder_of(gaussians, projected, hidden_beyond)
    raster = rasterize(
        projected,
        jnp.concatenate(columns, axis=-1),
        width=camera.width,
        height=camera.height,
        occluder=occluder,
        config=config,
    )
    colour, accumulated, alpha = raster.accumulated[..., :3], raster.accumulated[..., 3], raster.alpha
    if background is not None:
        colour = colour + (1 - alpha)[..., None] * background[None, None]
    hit = alpha > 0
    return RenderOutput(
        rgb=colour,
        depth=jnp.where(hit, accumulated, 0) / jnp.where(hit, alpha, 1),
        median_depth=jnp.where(raster.median >= 0, projected.depths[jnp.maximum(raster.median, 0)], 0),
        accumulated_depth=accumulated,
        alpha=alpha,
        features=None if features is None else raster.accumulated[..., 4 : 4 + features.shape[1]],
        overflow=raster.overflow,
        needed=raster.needed,
        surface_depth=None
        if slopes is None
        else surface_depth_of(raster.accumulated[..., -3:], alpha, middle),
    )
