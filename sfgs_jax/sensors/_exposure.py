"""Exposure of an image: the gain of each colour channel against the colours of the map.

An exposure multiplies light. Colours are a power of light, so it multiplies them too, and white balance
multiplies each channel. There is no offset: it would take on what the map lacks of an image's contrast.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked

LARGEST_GAIN = 4.0
"""Two stops of colours: the most that an image may differ from the map, so that gains can be undone."""
TYPICAL_COLOUR = 0.4
"""Mean colour of an image of a room, in [0, 1]: what a pixel of the prior shows."""


@checked
def fitted_gain(
    scene: Float[Array, "h w 3"],
    rgb: Float[Array, "h w 3"],
    weights: Float[Array, "h w"],
    prior_pixels: float,
) -> Float[Array, "3"]:
    """Factor on each channel that gives an image of the scene the mean colour of the camera's image.

    A ratio of means has no bias by noise or blur, which least squares would take for less contrast.

    Args:
        scene: image of the map.
        rgb: the camera's image.
        weights: of the pixels.
        prior_pixels: pixels of a typical colour that a gain of 1 counts for.
    """
    shown, seen = (jnp.sum(weights[..., None] * image, axis=(0, 1)) for image in (scene, rgb))
    known = prior_pixels * TYPICAL_COLOUR
    gain = jnp.where(shown + known > 0, (seen + known) / jnp.maximum(shown + known, 1e-9), 1)
    return jnp.clip(gain, 1 / LARGEST_GAIN, LARGEST_GAIN)


@checked
def with_gain(rgb: Float[Array, "h w 3"], gain: Float[Array, "3"]) -> Float[Array, "h w 3"]:
    """An image of the scene as the camera shows it.

    Args:
        rgb: colours of the scene.
        gain: of each channel.
    """
    return rgb * gain.reshape(1, 1, 3)
