"""Depth images at colour's time: what a camera that moves changes between the two exposures."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, require_depth
from sfgs_jax.sensors._timing import SensorTiming, carried, row_places

_ROUNDS = 2
"""Times that the pixel is looked for at which depth saw a ray; the second begins with the depth found."""
_NEAREST = 1e-6
"""Depth at which points behind the camera are looked for, which is nowhere in the image."""


@checked
def depth_in_time(
    depth: Float[Array, "h w"], camera: Camera, twist: Float[Array, "6"], timing: SensorTiming
) -> Float[Array, "h w"]:
    """Depth as it would have been seen when the same row of colour was exposed.

    Each ray takes the depth of the nearest pixel that saw its surface, carried to colour's time. So nothing
    is interpolated over edges, and a camera at rest changes nothing.

    Args:
        depth: metres along z, 0 where missing.
        camera: intrinsics of the image.
        twist: motion of the camera per second in its own frame, translation first.
        timing: times of the rows.

    Returns:
        Metres along z; 0 where the ray or its surface had no depth.

    Raises:
        InputError: the image is not of its camera's size.
    """
    require_depth(depth, camera.shape, "depth of depth_in_time", "its camera's")
    height, width = depth.shape
    flat = depth.reshape(-1)
    index = jnp.arange(flat.shape[0], dtype=jnp.int32)
    places = row_places((index // width).astype(depth.dtype), height)
    ahead = timing.depth_times(places) - timing.colour_times(places)

    def moved(index: Array, z: Array, times: Array) -> Float[Array, "3 N"]:
        # Column by column: XLA fuses these expressions, and not those of an array of pixels.
        u, v = (index % width).astype(z.dtype), (index // width).astype(z.dtype)
        x, y = (u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z
        return carried(jnp.stack([x, y, z]), twist, times)

    known, found = flat > 0, flat
    for _ in range(_ROUNDS):
        x, y, z = moved(index, jnp.where(known, found, 1), -ahead)
        z = jnp.maximum(z, _NEAREST)
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        column, row = jnp.round(u).astype(jnp.int32), jnp.round(v).astype(jnp.int32)
        known &= (column >= 0) & (column < width) & (row >= 0) & (row < height)
        place = jnp.where(known, row * width + column, 0)
        seen = flat[place]
        known &= seen > 0
        found = moved(place, jnp.where(known, seen, 1), ahead)[2]
    return jnp.where(known, found, 0).reshape(height, width)
