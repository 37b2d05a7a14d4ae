"""Optimisation of the map: one rendering of one keyframe, one step of Adam."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float, Int, UInt8

from sfgs_jax.geometry import Camera
from sfgs_jax.slam.config import OptimisationConfig, SeedingConfig
from sfgs_jax.slam.gaussian_map import GaussianMap, parameters, with_parameters
from sfgs_jax.slam.seeding import uncovered
from sfgs_jax.splatting import RenderConfig, RenderOutput, l1, render, ssim


def mapping_loss(
    out: RenderOutput, rgb: Float[Array, "h w 3"], depth: Float[Array, "h w"], config: OptimisationConfig
) -> Float[Array, ""]:
    """Loss of GS-ICP-SLAM: (1 - w) L1 + w (1 - SSIM) + w_depth L1(depth), the depth where it is measured."""
    colour = (1 - config.ssim_weight) * l1(out.rgb, rgb) + config.ssim_weight * (1 - ssim(out.rgb, rgb))
    # Where the map is still thin, its depth says nothing about where its Gaussians should be.
    measured = (depth > 0) & (out.alpha > 0.5)
    return colour + config.depth_weight * l1(out.depth, depth, measured)


class Optimised(NamedTuple):
    """What a step on a view gave.

    Attributes:
        map: after the step.
        loss: before it.
        missing: (H, W) pixels whose surface the map lacked before it.
        overflow: pairs that did not fit; where that is not 0 all of this is of an incomplete rendering, and
            the step should be repeated with more room.
    """

    map: GaussianMap
    loss: Float[Array, ""]
    missing: Bool[Array, "h w"]
    overflow: Int[Array, ""]


@eqx.filter_jit
def optimise(
    gaussian_map: GaussianMap,
    rgb: UInt8[Array, "h w 3"],
    depth: Float[Array, "h w"],
    camera: Camera,
    T_world_cam: jaxlie.SE3,
    config: OptimisationConfig,
    seeding: SeedingConfig,
    render_config: RenderConfig,
) -> Optimised:
    """One step of Adam on the Gaussians that a view sees.

    Each Gaussian counts its own steps: one that was set late starts with Adam's bias correction as one
    that was set early did, and one out of view keeps its place and its moments. The rendering that it takes
    also tells where the map lacks the view's surface.
    """
    colours = rgb.astype(jnp.float32) / 255

    def loss_of(values: dict[str, Array]) -> tuple[Array, tuple[Array, Array]]:
        out = render(
            with_parameters(gaussian_map.gaussians, values), camera, T_world_cam, config=render_config
        )
        return mapping_loss(out, colours, depth, config), (uncovered(out, depth, seeding), out.overflow)

    values = parameters(gaussian_map.gaussians)
    (loss, (missing, overflow)), gradients = jax.value_and_grad(loss_of, has_aux=True)(values)

    seen = gaussian_map.gaussians.valid & jnp.any(gradients["means"] != 0, axis=-1)
    updates = gaussian_map.updates + seen.astype(jnp.float32)
    first, second, moved = {}, {}, {}
    for name, gradient in gradients.items():
        here = seen.reshape(seen.shape + (1,) * (gradient.ndim - 1))
        count = jnp.maximum(updates, 1).reshape(here.shape)
        rate = getattr(config.learning_rates, name)
        m = _BETA1 * gaussian_map.first_moment[name] + (1 - _BETA1) * gradient
        v = _BETA2 * gaussian_map.second_moment[name] + (1 - _BETA2) * gradient**2
        step = (m / (1 - _BETA1**count)) / (jnp.sqrt(v / (1 - _BETA2**count)) + _EPSILON)
        moved[name] = jnp.where(here, values[name] - rate * step, values[name])
        first[name] = jnp.where(here, m, gaussian_map.first_moment[name])
        second[name] = jnp.where(here, v, gaussian_map.second_moment[name])
    optimised = GaussianMap(
        gaussians=with_parameters(gaussian_map.gaussians, moved),
        first_moment=first,
        second_moment=second,
        updates=updates,
        keyframes=gaussian_map.keyframes,
    )
    return Optimised(optimised, loss, missing, overflow)


_BETA1, _BETA2, _EPSILON = 0.9, 0.999, 1e-15


@eqx.filter_jit
def prune(gaussian_map: GaussianMap, min_opacity: float) -> GaussianMap:
    """The map without the Gaussians whose opacity is below `min_opacity` or that are not finite."""
    gaussians = gaussian_map.gaussians
    finite = jnp.ones_like(gaussians.valid)
    for value in parameters(gaussians).values():
        finite &= jnp.all(jnp.isfinite(value.reshape(value.shape[0], -1)), axis=-1)
    keep = gaussians.valid & finite & (jax.nn.sigmoid(gaussians.opacity_logits) >= min_opacity)
    return eqx.tree_at(lambda m: m.gaussians.valid, gaussian_map, keep)
