"""Keypoints of one image and matches between two, in a fixed number of slots."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import Text, checked, printed_count, printed_fields, require_least


class Features(eqx.Module):
    """K keypoint slots of one image, the best first; slots that are not `valid` hold zeros.

    Attributes:
        keypoints: (K, 2) pixels (u, v), with fractions; pixel centres lie at integers.
        scores: (K,) higher is better, comparable within one extractor only.
        descriptors: (K, D) of unit length, so that a dot product is the cosine similarity.
        valid: (K,) which slots hold a keypoint.
    """

    keypoints: Float[Array, "k 2"]
    scores: Float[Array, " k"]
    descriptors: Float[Array, "k d"]
    valid: Bool[Array, " k"]

    def __repr__(self) -> str:
        return printed_fields("Features", valid=Text(printed_count(self.valid)), descriptors=self.descriptors)


class Matches(eqx.Module):
    """Counterparts in image b of the K keypoint slots of image a.

    Attributes:
        index_b: (K,) slot in image b; 0 where not `valid`.
        similarity: (K,) cosine of the two descriptors; 0 where not `valid`.
        valid: (K,) which keypoints of image a are matched.
    """

    index_b: Int[Array, " k"]
    similarity: Float[Array, " k"]
    valid: Bool[Array, " k"]

    def __repr__(self) -> str:
        return printed_fields("Matches", valid=Text(printed_count(self.valid)))


@checked
def pack_features(
    keypoints: Float[np.ndarray, "n 2"],
    scores: Float[np.ndarray, " n"],
    descriptors: Float[np.ndarray, "n d"],
    *,
    capacity: int,
) -> Features:
    """Keypoints that another extractor found on the host, as `Features`.

    The best `capacity` keypoints come first, in float32, and empty slots behind them.

    Args:
        keypoints: (n, 2) pixels (u, v).
        scores: (n,) higher is better.
        descriptors: (n, d) of unit length.
        capacity: slots of the result, K.

    Raises:
        InputError: the capacity is negative.
    """
    require_least(capacity, 0, "capacity of pack_features")
    best = np.argsort(-scores, kind="stable")[:capacity]

    def fill(values: np.ndarray) -> np.ndarray:
        slots = np.zeros((capacity, *values.shape[1:]), np.float32)
        slots[: len(best)] = values[best]
        return slots

    return Features(
        keypoints=jnp.asarray(fill(keypoints)),
        scores=jnp.asarray(fill(scores)),
        descriptors=jnp.asarray(fill(descriptors)),
        valid=jnp.asarray(np.arange(capacity) < len(best)),
    )
