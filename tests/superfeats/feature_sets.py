"""Made-up features with known counterparts."""

import jax.numpy as jnp
import numpy as np

from sfgs_jax.superfeats import Features


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def make_features(
    keypoints: np.ndarray, descriptors: np.ndarray, valid: np.ndarray | None = None
) -> Features:
    valid = np.ones(len(keypoints), bool) if valid is None else valid
    return Features(
        jnp.asarray(np.where(valid[:, None], keypoints, 0), jnp.float32),
        jnp.asarray(valid, jnp.float32),
        jnp.asarray(np.where(valid[:, None], descriptors, 0), jnp.float32),
        jnp.asarray(valid),
    )
