"""Smaller images: block means of colours, and of depths that belong to one surface."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def _blocks(image: Array, factor: int) -> Array:
    """(h, w, factor * factor, ...) pixels of each block; rows and columns that don't fill one are dropped."""
    h, w = image.shape[0] // factor, image.shape[1] // factor
    cut = image[: h * factor, : w * factor].reshape(h, factor, w, factor, *image.shape[2:])
    return jnp.moveaxis(cut, 2, 1).reshape(h, w, factor * factor, *image.shape[2:])


def downscale_rgb(rgb: Float[Array, "H W 3"], factor: int) -> Float[Array, "h w 3"]:
    """Mean colour of each factor x factor block; the camera for it is `Camera.downscaled`."""
    return rgb if factor == 1 else jnp.mean(_blocks(rgb, factor), axis=2)


def downscale_depth(
    depth: Float[Array, "H W"], factor: int, *, edge_tolerance: float = 0.05
) -> Float[Array, "h w"]:
    """Mean depth of the nearest surface in each factor x factor block.

    Depths farther than the share `edge_tolerance` behind the block's nearest one belong to another
    surface: a mean over both would put a point in the air between them.

    Args:
        depth: (H, W) metres, 0 where missing.
        factor: size of the blocks.
        edge_tolerance: relative depth difference within one surface.

    Returns:
        (H // factor, W // factor) metres, 0 where the whole block is missing.
    """
    if factor == 1:
        return depth
    blocks = _blocks(depth, factor)
    nearest = jnp.min(jnp.where(blocks > 0, blocks, jnp.inf), axis=2, keepdims=True)
    same = ((blocks > 0) & (blocks <= nearest * (1 + edge_tolerance))).astype(depth.dtype)
    count = jnp.sum(same, axis=2)
    return jnp.sum(same * blocks, axis=2) / jnp.maximum(count, 1)
