"""Noise of a structured-light sensor, added to ideal images."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from sfgs_jax.datasets.synthetic._render import IdealView
from sfgs_jax.geometry import Camera

_BASELINE = 0.075
"""Metres between the projector and the infrared camera."""
_DISPARITY_STEP = 0.125
"""Pixels at a focal length of 580, the one of 640 columns."""
_GRAZING = 0.15
"""Cosine between normal and ray below which the pattern is no longer seen."""
_EDGE = 0.04
"""Relative jump between neighbours beside which depth is unreliable."""
_IMAGE_NOISE = 0.008
"""Standard deviation of colour, of 1."""


@jax.jit
def add_noise(
    key: PRNGKeyArray, view: IdealView, camera: Camera
) -> tuple[Float[Array, "h w 3"], Float[Array, "h w"]]:
    """Colour and depth as a structured-light camera (Kinect) would give them.

    Depth has axial noise of sigma = 0.0012 + 0.0019 (z - 0.4)² metres and the steps of a quantised disparity.
    It has holes at grazing angles and at depth edges. Colour has Gaussian noise.

    Source: Nguyen, Izadi and Lovell, Modeling Kinect Sensor Noise for Improved 3D Reconstruction and
    Tracking, 2012.

    Args:
        key: random key of the frame.
        view: the ideal images.
        camera: camera of the images.

    Returns:
        RGB in [0, 1], and depth in metres, 0 in holes.
    """
    colour_key, depth_key, hole_key = jax.random.split(key, 3)
    z = view.depth
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
    noisy = z + sigma * jax.random.normal(depth_key, z.shape)
    # Disparity of a sensor of 640 columns, whatever the size of the image.
    focal = camera.fx * (640 / camera.width)
    disparity = focal * _BASELINE / jnp.maximum(noisy, 0.1)
    disparity = jnp.maximum(jnp.round(disparity / _DISPARITY_STEP), 1) * _DISPARITY_STEP
    noisy = focal * _BASELINE / disparity
    lost = jax.random.uniform(hole_key, z.shape)
    hole = (z <= 0) | (view.facing < _GRAZING) | (_near_edge(z) & (lost < 0.5)) | (lost < 0.002)
    rgb = view.rgb + _IMAGE_NOISE * jax.random.normal(colour_key, view.rgb.shape)
    return jnp.clip(rgb, 0, 1), jnp.where(hole, 0, noisy)


def _near_edge(depth: Float[Array, "h w"]) -> Bool[Array, "h w"]:
    """Pixels beside a jump in depth, by second differences of 1/z, which is linear on a plane."""
    padded = jnp.pad(1 / jnp.maximum(depth, 0.1), 1, mode="edge")
    across = padded[1:-1, :-2] - 2 * padded[1:-1, 1:-1] + padded[1:-1, 2:]
    down = padded[:-2, 1:-1] - 2 * padded[1:-1, 1:-1] + padded[2:, 1:-1]
    return jnp.maximum(jnp.abs(across), jnp.abs(down)) * depth > _EDGE
