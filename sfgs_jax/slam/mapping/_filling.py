"""Depth where a view has none, from the map and from what lies around; a guess."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.jit
def filled(depth: Float[Array, "h w"]) -> Float[Array, "h w"]:
    """Depth in every pixel: holes take the mean depth of the smallest block around them that has any.

    Blocks have sides of 2, 4, 8 and so on (the pull-push of Gortler et al., The lumigraph, SIGGRAPH 1996,
    without its interpolation).

    Args:
        depth: metres along z; 0 where it is missing.

    Returns:
        (h, w) metres; 0 everywhere if no pixel has depth.
    """
    h, w = depth.shape
    levels = max(h - 1, w - 1).bit_length()
    blocks = [jnp.pad(depth, ((0, 2**levels - h), (0, 2**levels - w)))]
    for level in range(1, levels + 1):
        side = 2 ** (levels - level)
        four = blocks[-1].reshape(side, 2, side, 2)
        known = jnp.sum(four > 0, axis=(1, 3), dtype=depth.dtype)
        blocks.append(jnp.sum(four, axis=(1, 3)) / jnp.maximum(known, 1))
    whole = blocks.pop()
    for block in reversed(blocks):
        around = jnp.repeat(jnp.repeat(whole, 2, axis=0), 2, axis=1)
        whole = jnp.where(block > 0, block, around)
    return whole[:h, :w]
