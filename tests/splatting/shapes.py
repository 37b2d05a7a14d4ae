"""Shapes and directional colours of Gaussians, computed apart from the library."""

import numpy as np
from scipy.spatial.transform import Rotation

from sfgs_jax.splatting import Gaussians


def covariances(gaussians: Gaussians) -> np.ndarray:
    """(N, 3, 3) covariances, world coordinates, square metres."""
    quaternions = np.asarray(gaussians.quaternions, np.float64)
    axes = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    spread = axes * np.exp(np.asarray(gaussians.log_scales, np.float64))[:, None, :]
    return spread @ spread.transpose(0, 2, 1)


def harmonics(directions: np.ndarray) -> np.ndarray:
    """(N, 16) real spherical harmonics at unit directions (N, 3), in the order and with the signs of 3DGS.

    Source: the table in the glTF extension KHR_gaussian_splatting.
    """
    x, y, z = directions.T
    terms = [
        0.2820947918 * np.ones_like(x),
        -0.4886025119 * y,
        0.4886025119 * z,
        -0.4886025119 * x,
        1.0925484306 * x * y,
        -1.0925484306 * y * z,
        0.3153915653 * (2 * z**2 - x**2 - y**2),
        -1.0925484306 * x * z,
        0.5462742153 * (x**2 - y**2),
        -0.5900435899 * y * (3 * x**2 - y**2),
        2.8906114426 * x * y * z,
        -0.4570457995 * y * (4 * z**2 - x**2 - y**2),
        0.3731763326 * z * (2 * z**2 - 3 * x**2 - 3 * y**2),
        -0.4570457995 * x * (4 * z**2 - x**2 - y**2),
        1.4453057213 * z * (x**2 - y**2),
        -0.5900435899 * x * (x**2 - 3 * y**2),
    ]
    return np.stack(terms, axis=-1)
