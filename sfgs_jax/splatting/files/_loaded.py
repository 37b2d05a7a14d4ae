"""Gaussians from the values of a file, refused if they are damaged; opacities from bytes."""

from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float, UInt8
from scipy.special import logit

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting._gaussians import Gaussians

_LARGEST = {"means": 1e7, "quaternions": 1e7, "log_scales": 25.0, "opacity_logits": 1e4, "sh": 1e4}
"""Metres, and what no optimisation reaches."""


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
        InputError: a value is not finite or far beyond that of any map, or a quaternion is zero; the message
            names `path`.
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
        if not np.all(np.abs(value) < _LARGEST[name]):
            raise InputError(f"{path}: {name} hold values beyond {_LARGEST[name]:g}; the file is damaged.")
    if not np.all(np.any(quaternions != 0, axis=1)):
        raise InputError(f"{path}: a quaternion is zero; the file is damaged.")
    # Put on the device as they are: `jnp.asarray` would compile a program for each shape.
    arrays = {name: jax.device_put(value.astype(np.float32)) for name, value in values.items()}
    return Gaussians(**arrays, valid=jax.device_put(np.ones(len(means), bool)))


def logits_of_bytes(opacities: UInt8[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Logits of opacities that a file rounds to 255 steps.

    The bytes 0 and 255 stand for opacities within half a step of 0 and 1. The middle of that half step is
    taken, so that the logit is finite.
    """
    return logit(np.clip(opacities / 255, 0.25 / 255, 254.75 / 255))
