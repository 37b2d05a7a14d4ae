"""Depth between the pixels of an image."""

import jax.numpy as jnp
from jaxtyping import Array, Float

_EDGE = 1.05
"""Ratio of depths within two by two pixels beyond which there is an edge, and nothing to interpolate."""


def interpolated_depth(depth: Float[Array, "H W"], pixels: Float[Array, "2 N"]) -> Float[Array, " N"]:
    """Depth between pixels: that of the nearest one at an edge, 0 where it is missing and outside.

    Inverse depth is interpolated, for it is linear across a plane.

    Args:
        depth: (H, W) metres, 0 where missing.
        pixels: (2, N) u and v.
    """
    height, width = depth.shape
    column, row = (
        jnp.clip(jnp.floor(place), 0, max(size - 2, 0))
        for place, size in zip(pixels, (width, height), strict=True)
    )
    right, down = pixels[0] - column, pixels[1] - row
    inside = (jnp.abs(right - 0.5) <= 1) & (jnp.abs(down - 0.5) <= 1)
    # The four side by side, so that one gather copies all.
    flat = jnp.pad(depth.reshape(-1), (0, width + 1))
    four = jnp.stack([flat[step : step + depth.size] for step in (0, 1, width, width + 1)], axis=-1)
    around = four[(row * width + column).astype(jnp.int32)].T
    share = jnp.stack([(1 - right) * (1 - down), right * (1 - down), (1 - right) * down, right * down])
    near, far = around.min(axis=0), around.max(axis=0)
    smooth = (near > 0) & (far < _EDGE * near)
    between = 1 / jnp.sum(share / jnp.where(smooth[None], around, 1), axis=0)
    nearest = jnp.where(
        down > 0.5,
        jnp.where(right > 0.5, around[3], around[2]),
        jnp.where(right > 0.5, around[1], around[0]),
    )
    return jnp.where(inside, jnp.where(smooth, between, nearest), 0)
