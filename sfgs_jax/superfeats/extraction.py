"""From an image to keypoints with descriptors, in one jitted function."""

from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from sfgs_jax.geometry import InputError
from sfgs_jax.superfeats.detection import (
    MIN_HEAT,
    away_from_border,
    cut,
    heat_map,
    local_maxima,
    refine,
    strongest,
)
from sfgs_jax.superfeats.features import Features
from sfgs_jax.superfeats.losses import unit
from sfgs_jax.superfeats.network import STRIDE, Network, branches, linear, normalise
from sfgs_jax.superfeats.sampling import sample


def extract(
    params: Network,
    image: Num[Array | np.ndarray, "h w"] | Num[Array | np.ndarray, "h w 3"],
    *,
    max_keypoints: int = 1024,
    min_heat: float = MIN_HEAT,
) -> Features:
    """Finds keypoints and describes them: SuperFeats, SFGS-SLAM (Wang and Deng, 2025), section 3.1.

    Heat map by softmax, maxima of 5 x 5 windows at least 4 pixels from the border, the strongest of them,
    their centroids, and descriptors interpolated there. Differentiable with respect to weights and image
    through positions, scores and descriptors; which pixels are chosen is not. Compiled once for each image
    size and `max_keypoints`.

    Args:
        params: a folded network: `load_weights()`, or `fold` of a network in training.
        image: grey, or RGB, whose mean is taken; any size, any range of values, integers too.
        max_keypoints: K, slots for keypoints.
        min_heat: probability of a keypoint at its pixel below which there is none.

    Returns:
        Features with K slots: pixels (u, v), scores in [0, 1] (heat times reliability), 64-D descriptors.

    Raises:
        InputError: `max_keypoints` isn't positive, or the image has no pixels.
    """
    if max_keypoints < 1:
        raise InputError(f"max_keypoints must be at least 1, not {max_keypoints}.")
    if image.size == 0:
        raise InputError(f"The image is empty: its shape is {image.shape}.")
    if isinstance(image, np.ndarray) and image.ndim == 3:
        image = mean_grey(image)
    if not jnp.issubdtype(image.dtype, jnp.floating):
        image = image.astype(jnp.result_type(float))
    # What lies on the host goes into the call as it is: each array made before would cost a twentieth of it.
    return _extract(params, image, np.asarray(min_heat, image.dtype), max_keypoints=max_keypoints)


def mean_grey(image: Num[Array | np.ndarray, "h w 3"]) -> Float[Array | np.ndarray, "h w"]:
    """The mean of the channels; on the host if the image lies there, so that a third is left to carry."""
    if not isinstance(image, np.ndarray):
        # A sum of slices takes a quarter of the time of a mean over three neighbours.
        return (image[..., 0] + image[..., 1] + image[..., 2]) / 3
    if image.dtype not in (np.float32, np.float64):
        image = image.astype(np.float32)
    return cv2.transform(image, np.full((1, 3), 1 / 3))


@partial(jax.jit, static_argnames="max_keypoints")
def _extract(
    params: Network,
    image: Float[Array | np.ndarray, "h w"] | Float[Array | np.ndarray, "h w 3"],
    min_heat: Float[Array | np.ndarray, ""],
    *,
    max_keypoints: int,
) -> Features:
    grey = jnp.asarray(mean_grey(image) if image.ndim == 3 else image)
    height, width = grey.shape
    # The network wants whole cells at its coarsest level: beyond the image lies the image's mean.
    padding = [(0, -side % STRIDE) for side in grey.shape]
    logits, cells = branches(params, jnp.pad(normalise(grey[None])[0], padding)[None])

    heat = cut(heat_map(logits[:, 0]), height, width)
    chosen = local_maxima(heat) & (heat > min_heat) & away_from_border(heat, height, width)
    reliability = jax.nn.sigmoid(linear(params.rely, cells[0])[..., 0])
    scores, pixels = strongest(jnp.where(chosen, heat * reliability, 0.0), count=max_keypoints)
    valid = scores > 0
    keypoints = refine(heat, pixels)
    # The last layer is linear, and so the same before and after the interpolation, where it costs less.
    descriptors = unit(linear(params.describe, sample(cells[0], keypoints)))
    return Features(
        keypoints=jnp.where(valid[:, None], keypoints, 0.0),
        scores=scores,
        descriptors=jnp.where(valid[:, None], descriptors, 0.0),
        valid=valid,
    )
