"""Signature of a whole image, for place recognition."""

import jax.numpy as jnp
import numpy as np
from jax.lax import Precision
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.superfeats import Features

_COMPONENTS = 64
"""Components of a descriptor that take part. 32 find as many places, but the candidates agree less often
(`python -m experiments.signatures`, `python -m experiments.relocalisation`)."""


@checked
def image_signature(features: Features, *, components: int = _COMPONENTS) -> Float[Array, " d"]:
    """Descriptor of a whole image, of unit length: the second moments of its keypoints' descriptors.

    Their signed square roots keep frequent structures from drowning rare ones. Two images' signatures are
    compared by their dot product, at most 1. Source: Carreira et al., Semantic segmentation with
    second-order pooling (ECCV 2012), with the power normalisation used for image retrieval.

    Args:
        features: of the image.
        components: C, first components of a descriptor that take part.

    Returns:
        (C (C + 1) / 2,), 0 without keypoints.
    """
    part = jnp.where(features.valid[:, None], features.descriptors, 0)[:, :components]
    count = jnp.maximum(jnp.sum(features.valid.astype(part.dtype)), 1)
    rows, columns = np.triu_indices(part.shape[1])
    moments = jnp.matmul(part.T, part, precision=Precision.HIGHEST)[rows, columns] / count
    # A moment beside the diagonal stands for two.
    times = np.where(rows == columns, 1, np.sqrt(2)).astype(part.dtype)
    rooted = times * jnp.sign(moments) * jnp.sqrt(jnp.maximum(jnp.abs(moments), 1e-12))
    return jnp.where(jnp.any(features.valid), rooted / jnp.linalg.norm(rooted), 0)


@checked
def most_similar(
    signatures: Float[np.ndarray, "n d"],
    signature: Float[np.ndarray, " d"],
    count: int,
    *,
    among: Bool[np.ndarray, " n"] | None = None,
) -> tuple[Int[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """The images most similar to another one, the most similar first and the earlier of equals.

    Args:
        signatures: (n, D) of the images, of unit length.
        signature: (D,) of the other one, of unit length.
        count: most images.
        among: (n,) images that are looked at; all if not given.

    Returns:
        (k,) their numbers and (k,) their cosines.
    """
    cosines = signatures @ signature
    known = np.arange(len(signatures)) if among is None else np.flatnonzero(among)
    if len(known) > count:
        # A full sort of many thousands would take as long as the product.
        least = np.partition(cosines[known], len(known) - count)[len(known) - count] if count else np.inf
        known = known[cosines[known] >= least]
    best = known[np.argsort(-cosines[known], kind="stable")][:count]
    return best, cosines[best]
