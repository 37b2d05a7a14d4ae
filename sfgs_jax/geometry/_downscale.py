"""Smaller images: block means of colours, and of depths that belong to one surface."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, require_least


def _strided(image: Array, factor: int) -> list[Array]:
    """The factor² images of one pixel of each block; rows and columns that don't fill a block are dropped.

    XLA fuses arithmetic on strided slices. A reshape to blocks it would copy, at 25 times the cost.
    """
    h, w = image.shape[0] // factor, image.shape[1] // factor
    cut = image[: h * factor, : w * factor]
    return [cut[i::factor, j::factor] for i in range(factor) for j in range(factor)]


@checked
def downscale_rgb(rgb: Float[Array, "H W 3"], factor: int) -> Float[Array, "h w 3"]:
    """Mean colour of each factor x factor block; the camera for it is `Camera.downscaled`."""
    require_least(factor, 1, "factor of downscale_rgb")
    pixels = _strided(rgb, factor)
    return sum(pixels[1:], pixels[0]) / len(pixels)


@checked
def downscale_depth(
    depth: Float[Array, "H W"], factor: int, *, edge_tolerance: float = 0.05
) -> Float[Array, "h w"]:
    """Mean depth of the nearest surface in each factor x factor block.

    Depths farther than the share `edge_tolerance` behind the block's nearest one belong to another
    surface. A mean over both would put a point in the air between them.

    Args:
        depth: (H, W) metres, 0 where missing.
        factor: size of the blocks.
        edge_tolerance: relative depth difference within one surface.

    Returns:
        (H // factor, W // factor) metres, 0 where the whole block is missing.

    Raises:
        InputError: the factor is below 1.
    """
    require_least(factor, 1, "factor of downscale_depth")
    pixels = _strided(depth, factor)
    nearest = jnp.full_like(pixels[0], jnp.inf)
    for pixel in pixels:
        nearest = jnp.where(pixel > 0, jnp.minimum(nearest, pixel), nearest)
    total, count = jnp.zeros_like(nearest), jnp.zeros_like(nearest)
    for pixel in pixels:
        same = (pixel > 0) & (pixel <= nearest * (1 + edge_tolerance))
        total += jnp.where(same, pixel, 0)
        count += jnp.where(same, 1, 0)
    return total / jnp.maximum(count, 1)
