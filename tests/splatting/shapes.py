"""Shapes of Gaussians in a map's axes, whatever quaternions and scales describe them."""

import numpy as np
from scipy.spatial.transform import Rotation

from sfgs_jax.splatting import Gaussians


def covariances(gaussians: Gaussians) -> np.ndarray:
    """(N, 3, 3) covariances, world coordinates, square metres."""
    quaternions = np.asarray(gaussians.quaternions, np.float64)
    axes = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    spread = axes * np.exp(np.asarray(gaussians.log_scales, np.float64))[:, None, :]
    return spread @ spread.transpose(0, 2, 1)
