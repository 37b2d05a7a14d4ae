"""Images of projected Gaussians with any features."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sfgs_jax.splatting.binning import bin_into_tiles
from sfgs_jax.splatting.compositing import composite
from sfgs_jax.splatting.config import DEFAULT, RenderConfig
from sfgs_jax.splatting.projection import Projected


def rasterize(
    projected: Projected,
    features: Float[Array, "n c"],
    *,
    width: int,
    height: int,
    config: RenderConfig = DEFAULT,
) -> tuple[Float[Array, "h w c"], Float[Array, "h w"], Int[Array, ""]]:
    """Composite the features of the Gaussians front to back.

    Reverse-mode differentiable in `projected` and `features`; forward mode is refused by JAX, because
    the gradient is given by hand.

    Args:
        projected: images of N Gaussians.
        features: (N, C) what to composite: colours, depths, anything. Lanes that are not visible must be
            finite.
        width: of the image, pixels.
        height: of the image, pixels.
        config: settings.

    Returns:
        accumulated: (H, W, C) sums over the Gaussians of weight times feature.
        alpha: (H, W) sums of the weights, in [0, 1].
        overflow: (tile, Gaussian) pairs that found no room; 0 when the images are complete.
    """
    lists = bin_into_tiles(
        jax.lax.stop_gradient(projected),
        width=width,
        height=height,
        tile_size=config.tile_size,
        pair_capacity=config.pair_capacity,
        near=config.near,
        far=config.far,
    )
    columns = [projected.centres, projected.whitening, projected.log_opacities[:, None]]
    table = jnp.concatenate([*columns, features], axis=-1)
    image: Array = composite(table, lists, width, height, config.tile_size)
    return image[..., :-1], image[..., -1], lists.overflow
