"""From a heat map to keypoints."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float

from sfgs_jax.superfeats.network import CELL

_REACH = 2
"""Pixels to each side over which a keypoint must be the maximum: a window of 5 x 5."""


def heat_map(logits: Float[Array, "r c 65"]) -> Float[Array, "h w"]:
    """Probability of a keypoint at each pixel: softmax over a cell's positions and its dustbin."""
    rows, columns, _ = logits.shape
    # Without the maximum taken off, which softmax does for safety, the exponentials fuse with the rest.
    weights = jnp.exp(jnp.clip(logits, -80.0, 80.0))
    p = weights[..., :-1] / weights.sum(-1, keepdims=True)
    return p.reshape(rows, columns, CELL, CELL).transpose(0, 2, 1, 3).reshape(rows * CELL, columns * CELL)


def local_maxima(heat: Float[Array, "h w"]) -> Bool[Array, "h w"]:
    """Pixels that no other within two pixels exceeds."""
    # Shifted slices fuse into one loop; `reduce_window` takes five times as long on a CPU.
    highest = _running_maximum(_running_maximum(heat, 0), 1)
    return heat >= highest


def strongest(scores: Float[Array, "h w"], *, count: int) -> tuple[Float[Array, " k"], Float[Array, "k 2"]]:
    """The `count` highest scores, in falling order, and their pixels (u, v); scores of 0 fill up."""
    width = scores.shape[1]
    flat = scores.reshape(-1)
    found, index = lax.top_k(flat, min(count, flat.size))
    missing = count - found.size
    found, index = jnp.pad(found, (0, missing)), jnp.pad(index, (0, missing))
    return found, jnp.stack([index % width, index // width], -1).astype(scores.dtype)


def refine(heat: Float[Array, "h w"], pixels: Float[Array, "k 2"]) -> Float[Array, "k 2"]:
    """Moves each pixel (u, v) to the centroid of the heat in the 3 x 3 around it.

    Differentiable with respect to the heat.
    """
    h, w = heat.shape
    steps = jnp.arange(-1, 2)
    u, v = pixels.astype(jnp.int32).T
    rows = v[:, None, None] + steps[:, None]
    columns = u[:, None, None] + steps
    inside = (rows >= 0) & (rows < h) & (columns >= 0) & (columns < w)
    around = jnp.where(inside, heat[jnp.clip(rows, 0, h - 1), jnp.clip(columns, 0, w - 1)], 0.0)
    total = jnp.maximum(around.sum((1, 2)), 1e-12)
    shift_u = (around[:, :, 2] - around[:, :, 0]).sum(1) / total
    shift_v = (around[:, 2] - around[:, 0]).sum(1) / total
    return pixels + jnp.stack([shift_u, shift_v], -1)


def _running_maximum(x: Float[Array, "h w"], axis: int) -> Float[Array, "h w"]:
    size = x.shape[axis]
    padding = [(0, 0), (0, 0)]
    padding[axis] = (_REACH, _REACH)
    padded = jnp.pad(x, padding)
    result = x
    for start in range(2 * _REACH + 1):
        result = jnp.maximum(result, lax.slice_in_dim(padded, start, start + size, axis=axis))
    return jax.lax.stop_gradient(result)
