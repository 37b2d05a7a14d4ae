"""From the keypoints that another extractor found on the host to `Features` of a fixed size."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.superfeats.features import Features


def pack_features(
    keypoints: Float[np.ndarray, "n 2"],
    scores: Float[np.ndarray, " n"],
    descriptors: Float[np.ndarray, "n d"],
    *,
    capacity: int,
) -> Features:
    """The best `capacity` keypoints, the best first, in float32, with empty slots behind them.

    Args:
        keypoints: (n, 2) pixel (u, v).
        scores: (n,) higher is better.
        descriptors: (n, d) of unit length.
        capacity: slots of the result, K.
    """
    best = np.argsort(-scores, kind="stable")[:capacity]

    def fill(values: np.ndarray) -> np.ndarray:
        slots = np.zeros((capacity, *values.shape[1:]), np.float32)
        slots[: len(best)] = values[best]
        return slots

    return Features(
        jnp.asarray(fill(keypoints)),
        jnp.asarray(fill(scores)),
        jnp.asarray(fill(descriptors)),
        jnp.asarray(np.arange(capacity) < len(best)),
    )
