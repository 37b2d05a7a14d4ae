"""The map: Gaussians of fixed capacity."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float


class Gaussians(eqx.Module):
    """N slots for 3-D Gaussians, of which `valid` ones are in use.

    What the other slots hold, NaN included, changes no rendering and no gradient.

    Attributes:
        means: (N, 3) centres, world coordinates, metres.
        quaternions: (N, 4) wxyz: rotation from the Gaussian's axes to the world's. Of any length; zero does
            not rotate.
        log_scales: (N, 3) logarithms of the standard deviations along its axes, metres.
        opacity_logits: (N,) opacity before the sigmoid.
        sh: (N, K, 3) spherical-harmonics coefficients of RGB, K = (degree + 1)², degree 0 to 3.
        valid: (N,) which slots are in use.
    """

    means: Float[Array, "n 3"]
    quaternions: Float[Array, "n 4"]
    log_scales: Float[Array, "n 3"]
    opacity_logits: Float[Array, " n"]
    sh: Float[Array, "n k 3"]
    valid: Bool[Array, " n"]


def valid_arrays(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Parameters of the valid Gaussians by name, float32 on the host; quaternions of unit length."""
    valid = np.asarray(gaussians.valid)
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    arrays = {name: np.asarray(getattr(gaussians, name), np.float32)[valid] for name in names}
    length = np.linalg.norm(arrays["quaternions"], axis=1, keepdims=True)
    unit = arrays["quaternions"] / np.where(length > 0, length, 1)
    arrays["quaternions"] = np.where(length > 0, unit, np.asarray([1, 0, 0, 0], np.float32))
    return arrays
