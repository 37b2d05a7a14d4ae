"""SuperFeats: from an image to keypoints with descriptors, in one jitted function."""

from functools import partial

import cv2
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Num

from sfgs_jax.arrays import InputError, checked, checked_but, described, is_array
from sfgs_jax.superfeats._descriptors import sample, unit
from sfgs_jax.superfeats._features import Features
from sfgs_jax.superfeats.detection import MIN_HEAT, detect
from sfgs_jax.superfeats.network import STRIDE, Network, branches, linear, normalise


@checked_but("image")
def extract(
    params: Network,
    image: Num[Array | np.ndarray, "h w"] | Num[Array | np.ndarray, "h w 3"],
    *,
    max_keypoints: int = 1024,
    min_heat: float = MIN_HEAT,
) -> Features:
    """Find keypoints and describe them with SuperFeats.

    Keypoints are maxima of a heat map, at least 4 pixels from the border; descriptors are interpolated at
    their sub-pixel positions. Differentiable with respect to weights and image through positions, scores and
    descriptors; the choice of pixels is not. Compiled once for each image size and `max_keypoints`.

    The network's convolutions run at the default precision, TF32 on recent GPUs, with little effect: see
    `docs/superfeats.md`.

    Args:
        params: a folded network: `load_weights()`, or `fold` of a network in training.
        image: grey (H, W), or RGB (H, W, 3), whose mean is taken; any size and range of values, integers too.
        max_keypoints: K, slots for keypoints; static.
        min_heat: least probability of a keypoint at its pixel. A new value does not compile anew.

    Returns:
        Features with K slots: pixels (u, v), scores in [0, 1] (heat times reliability), 64-D descriptors.

    Raises:
        InputError: `max_keypoints` isn't positive, the image is none or has no pixels, or the network is not
            folded.

    Source: Wang and Deng, SFGS-SLAM (2025), section 3.1.
    """
    if max_keypoints < 1:
        raise InputError(f"max_keypoints must be at least 1, not {max_keypoints}.")
    if not is_array(image) or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise InputError(f"The image is grey (H, W) or RGB (H, W, 3), not {described(image)}.")
    if image.size == 0:
        raise InputError(f"The image is empty: its shape is {image.shape}.")
    if image.dtype == bool or not jnp.issubdtype(image.dtype, jnp.number):
        raise InputError(f"The image holds real numbers, not {image.dtype}.")
    if isinstance(image, np.ndarray) and image.ndim == 3:
        image = mean_grey(image)
    if not jnp.issubdtype(image.dtype, jnp.floating):
        image = image.astype(jnp.result_type(float))
    # Arrays on the host go into the call unconverted: each conversion before would cost a twentieth of it.
    return _extract(params, image, np.asarray(min_heat, image.dtype), max_keypoints=max_keypoints)


@checked
def mean_grey(image: Num[Array | np.ndarray, "h w 3"]) -> Float[Array | np.ndarray, "h w"]:
    """Mean of the channels. An image on the host is averaged there, so that a third is left to transfer."""
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
    # The network needs whole cells at its coarsest level. Zeros stand for the image's mean.
    padding = [(0, -side % STRIDE) for side in grey.shape]
    logits, cells = branches(params, jnp.pad(normalise(grey[None])[0], padding)[None])

    reliability = jax.nn.sigmoid(linear(params.rely, cells[0])[..., 0])
    keypoints, scores = detect(
        logits[:, 0], reliability, jnp.asarray(min_heat), shape=(height, width), max_keypoints=max_keypoints
    )
    keypoints, valid = keypoints + params.shift[None], scores > 0
    # The last layer is linear, so it commutes with the interpolation and costs less after it.
    descriptors = unit(linear(params.describe, sample(cells[0], keypoints)))
    return Features(
        keypoints=jnp.where(valid[:, None], keypoints, 0.0),
        scores=scores,
        descriptors=jnp.where(valid[:, None], descriptors, 0.0),
        valid=valid,
    )
