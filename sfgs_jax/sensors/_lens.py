"""Lens distortion by OpenCV's model, as a pure function."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.ndimage import map_coordinates
from jaxtyping import Array, Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import Camera, clean_depth, require_depth
from sfgs_jax.sensors._depth_interpolation import interpolated_depth

_COUNTS = (4, 5, 8)


@checked
def undistorted(
    rgb: Float[Array | np.ndarray, "H W 3"],
    depth: Float[Array | np.ndarray, "H W"],
    camera: Camera,
    coefficients: Float[Array | np.ndarray, " K"],
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    """Registered images as a pinhole camera of the same intrinsics would have seen them.

    Readers do the same on the host, several times as fast (`Undistortion`). This one has derivatives by
    images, intrinsics and lens, so that a pose can be differentiated by the lens.

    Args:
        rgb: (H, W, 3) colour.
        depth: (H, W) metres along z; not finite or not positive counts as missing.
        camera: intrinsics, before and after.
        coefficients: (4,), (5,) or (8,) k1, k2, p1, p2, k3, k4, k5, k6 as in OpenCV.

    Returns:
        Colour, black beyond the lens's field of view, and depth in metres, 0 there and where it is missing.
        At an edge depth is that of the nearest pixel.

    Raises:
        InputError: the images are no floating-point images of the camera's size, or there are other than 4, 5
            or 8 coefficients.
    """
    require_depth(depth, camera.shape, "The depth image", "its camera's")
    if len(coefficients) not in _COUNTS:
        raise InputError(f"A lens has 4, 5 or 8 coefficients (k1, k2, p1, p2, ...), not {len(coefficients)}.")
    return _undistorted(rgb, depth, camera, coefficients)


@jax.jit
def _undistorted(
    rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"], camera: Camera, coefficients: Float[Array, " K"]
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W"]]:
    depth, _ = clean_depth(depth)
    seen = _distorted(camera.pixels().reshape(-1, 2).T, camera, coefficients)
    where = [x.reshape(depth.shape) for x in (seen[1], seen[0])]
    channels = [map_coordinates(rgb[..., i], where, order=1, mode="constant") for i in range(3)]
    return jnp.stack(channels, axis=-1), interpolated_depth(depth, seen).reshape(depth.shape)


def _distorted(
    pixels: Float[Array, "2 N"], camera: Camera, coefficients: Float[Array, " K"]
) -> Float[Array, "2 N"]:
    """Where the lens shows what a pinhole camera would show at some pixels."""
    k1, k2, p1, p2, k3, k4, k5, k6 = jnp.pad(coefficients, (0, max(_COUNTS) - len(coefficients)))
    x, y = (pixels[0] - camera.cx) / camera.fx, (pixels[1] - camera.cy) / camera.fy
    square = x * x + y * y
    radial = (1 + square * (k1 + square * (k2 + square * k3))) / (
        1 + square * (k4 + square * (k5 + square * k6))
    )
    u = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    v = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return jnp.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy])
