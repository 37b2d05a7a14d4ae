"""Depth images at colour's time: what a camera that moves changes between the two exposures."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, require_depth
from sfgs_jax.sensors._timing import SensorTiming, carried, row_places

_ROUNDS = 2
"""Times that the pixel is looked for at which depth saw a ray; the second begins with the depth found."""


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
    pixels = camera.pixels().reshape(-1, 2)
    places = row_places(pixels[:, 1], height)
    ahead = timing.depth_times(places) - timing.colour_times(places)
    flat = depth.reshape(-1)
    known, found = flat > 0, flat
    for _ in range(_ROUNDS):
        points = camera.unproject(pixels, jnp.where(known, found, 1)).T
        there = jnp.round(camera.project(carried(points, twist, -ahead).T)).astype(jnp.int32)
        inside = (there >= 0) & (there < jnp.asarray([[width, height]]))
        known &= inside[:, 0] & inside[:, 1]
        place = jnp.where(known, there[:, 1] * width + there[:, 0], 0)
        seen = flat[place]
        known &= seen > 0
        points = camera.unproject(pixels[place], jnp.where(known, seen, 1)).T
        found = carried(points, twist, ahead)[2]
    return jnp.where(known, found, 0).reshape(height, width)
