"""Signature of a whole image, for place recognition."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.superfeats import Features

_SIGNATURE_SIZE = 64


def image_signature(features: Features) -> Float[Array, " d"]:
    """Descriptor of a whole image: the second moments of its keypoints' descriptors.

    Their signed square roots keep frequent structures from drowning rare ones. Two images' signatures are
    compared by their dot product, at most 1. Source: Carreira et al., Semantic segmentation with
    second-order pooling (ECCV 2012), with the power normalisation used for image retrieval.
    """
    part = jnp.where(features.valid[:, None], features.descriptors, 0)[:, :_SIGNATURE_SIZE]
    count = jnp.maximum(jnp.sum(features.valid.astype(part.dtype)), 1)
    moments = (part.T @ part / count).reshape(-1)
    rooted = jnp.sign(moments) * jnp.sqrt(jnp.maximum(jnp.abs(moments), 1e-12))
    return jnp.where(jnp.any(features.valid), rooted / jnp.linalg.norm(rooted), 0)


def similarities(
    signatures: Float[np.ndarray, "n d"], signature: Float[np.ndarray, " d"]
) -> Float[np.ndarray, " n"]:
    """(n,) cosines between the signatures of images and another one.

    Args:
        signatures: (n, D) of unit length.
        signature: (D,) of unit length.
    """
    return signatures @ signature
