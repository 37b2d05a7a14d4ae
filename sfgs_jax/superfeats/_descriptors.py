"""Descriptors: bilinear interpolation on the map of cells, unit length, cosines of all pairs."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.superfeats.network import CELL

_TINY = 1e-12
"""Added to squared lengths, so that a vector of zeros stays zero."""


def to_cells(pixels: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Pixels (u, v) as (column, row) on the map of cells, whose centres lie at integers."""
    return (pixels - (CELL - 1) / 2) / CELL


@checked
def sample(cells: Float[Array, "h w c"], pixels: Float[Array, "n 2"]) -> Float[Array, "n c"]:
    """Bilinear interpolation of a map of cells; outside, the border's values go on.

    Args:
        cells: (H/8, W/8, C) values of the cells.
        pixels: (N, 2) positions (u, v) in the image.
    """
    h, w, _ = cells.shape
    column, row = to_cells(pixels).T
    column = jnp.clip(column, 0, w - 1)
    row = jnp.clip(row, 0, h - 1)
    left = jnp.clip(jnp.floor(column).astype(jnp.int32), 0, max(w - 2, 0))
    top = jnp.clip(jnp.floor(row).astype(jnp.int32), 0, max(h - 2, 0))
    right = jnp.minimum(left + 1, w - 1)
    bottom = jnp.minimum(top + 1, h - 1)
    x = (column - left.astype(column.dtype))[:, None]
    y = (row - top.astype(row.dtype))[:, None]
    upper = cells[top, left] * (1 - x) + cells[top, right] * x
    lower = cells[bottom, left] * (1 - x) + cells[bottom, right] * x
    return upper * (1 - y) + lower * y


@checked
def unit(x: Float[Array, "*n d"]) -> Float[Array, "*n d"]:
    """Vectors scaled to unit length; zero stays zero."""
    return x * jax.lax.rsqrt(jnp.square(x).sum(-1, keepdims=True) + _TINY)


def cosines(a: Float[Array, "k d"], b: Float[Array, "m d"]) -> Float[Array, "k m"]:
    """Dot products of all pairs of descriptors.

    In float32 on every device: TF32 errs by up to 1e-3, and floors for matches are set to a hundredth.
    """
    return jnp.matmul(a, b.T, precision=jax.lax.Precision.HIGHEST)
