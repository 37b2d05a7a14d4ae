"""Gaussians from the values of a file, refused if they are damaged."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting._gaussians import Gaussians


def loaded(
    path: Path,
    *,
    means: Float[np.ndarray, "n 3"],
    quaternions: Float[np.ndarray, "n 4"],
    log_scales: Float[np.ndarray, "n 3"],
    opacity_logits: Float[np.ndarray, " n"],
    sh: Float[np.ndarray, "n k 3"],
) -> Gaussians:
    """Valid Gaussians in float32, with the units and shapes of `Gaussians`.

    Raises:
        InputError: a value is not finite or a quaternion is zero; the message names `path`.
    """
    values = {
        "means": means,
        "quaternions": quaternions,
        "log_scales": log_scales,
        "opacity_logits": opacity_logits,
        "sh": sh,
    }
    for name, value in values.items():
        if not np.all(np.isfinite(value)):
            raise InputError(f"{path}: {name} hold values that are not finite; the file is damaged.")
    if not np.all(np.any(quaternions != 0, axis=1)):
        raise InputError(f"{path}: a quaternion is zero; the file is damaged.")
    arrays = {name: jnp.asarray(value.astype(np.float32)) for name, value in values.items()}
    return Gaussians(**arrays, valid=jnp.asarray(np.ones(len(means), bool)))
