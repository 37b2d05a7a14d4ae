"""Depth registration: a depth image in another camera's view, by drawing its pixels with a z-buffer."""

from functools import partial

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, from_ordered_bits, ordered_bits, require_least
from sfgs_jax.geometry import se3
from sfgs_jax.geometry._camera import Camera
from sfgs_jax.geometry._depth_cleaning import clean_depth
from sfgs_jax.geometry._image_checks import require_depth

# Neighbouring depth pixels on a slanted surface land a little further apart than their footprints are wide.
# This factor on the footprints closes the cracks on surfaces up to about 60 degrees.
_MARGIN = 1.15


@checked
@partial(jax.jit, static_argnames=("max_footprint",))
def register_depth(
    depth: Float[Array, "h w"],
    depth_camera: Camera,
    camera: Camera,
    T_camera_depth: se3.Pose,
    *,
    max_footprint: int = 2,
) -> Float[Array, "H W"]:
    """Depth image as another camera sees it.

    Each depth pixel is drawn, as a rectangle facing the camera and 15 % wider than the pixel, over the pixels
    whose centres it covers. The nearest one wins. Pixels that no depth pixel covers, which only the other
    camera sees, are missing (0). Not differentiable.

    Args:
        depth: (h, w) metres along the depth camera's z; not finite or not positive means missing.
        depth_camera: the camera of `depth`.
        camera: the camera to register to, of any size.
        T_camera_depth: depth camera coordinates to camera coordinates, `jaxlie.SE3` or a 4 x 4 matrix.
        max_footprint: most pixels along an axis that one depth pixel is drawn over; 2 is enough while the
            ratio of the focal lengths is below about 1.7. Static.

    Returns:
        (H, W) metres along the other camera's z, 0 where missing.

    Raises:
        InputError: the image is not of its camera's size, or the footprint is below 1.
    """
    require_depth(depth, depth_camera.shape, "depth of register_depth", "its camera's")
    require_least(max_footprint, 1, "max_footprint of register_depth")
    depth, valid = clean_depth(depth)
    points = se3.transform(T_camera_depth, depth_camera.unproject(depth_camera.pixels(), depth))
    z = points[..., 2]
    valid &= z > 0
    safe_z = jnp.where(valid, z, 1)
    pixels = camera.project(points)
    # Half a depth pixel at its own depth, in pixels of the other camera.
    half = 0.5 * _MARGIN * depth / safe_z
    half_u = half * (camera.fx / depth_camera.fx)
    half_v = half * (camera.fy / depth_camera.fy)
    first_u = jnp.ceil(pixels[..., 0] - half_u)
    first_v = jnp.ceil(pixels[..., 1] - half_v)
    last_u = jnp.floor(pixels[..., 0] + half_u)
    last_v = jnp.floor(pixels[..., 1] + half_v)

    # Minima of integers, unlike those of floats, scatter in any order alike.
    keys = ordered_bits(safe_z.astype(jnp.float32))
    nothing = ~jnp.uint32(0)
    size = camera.width * camera.height
    buffer = jnp.full(size, nothing, jnp.uint32)
    for dv in range(max_footprint):
        for du in range(max_footprint):
            u, v = first_u + du, first_v + dv
            inside = valid & (u <= last_u) & (v <= last_v)
            inside &= (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
            index = jnp.where(inside, v * camera.width + u, size).astype(jnp.int32)
            buffer = buffer.at[index.ravel()].min(keys.ravel(), mode="drop")
    nearest = from_ordered_bits(buffer).astype(depth.dtype)
    return jnp.where(buffer == nothing, 0, nearest).reshape(camera.shape)
