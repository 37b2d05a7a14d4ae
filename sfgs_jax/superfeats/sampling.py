"""Values of a map of cells at pixel positions."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.superfeats.network import CELL


def to_cells(pixels: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Pixel (u, v) as (column, row) on the map of cells, whose centres lie at integers."""
    return (pixels - (CELL - 1) / 2) / CELL


def sample(cells: Float[Array, "h w c"], pixels: Float[Array, "n 2"]) -> Float[Array, "n c"]:
    """Bilinear interpolation of a map of cells at pixels (u, v); the border's values go on outside."""
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
