"""Axes of files: the map's y down and z forward, against y up and z backward."""

from collections.abc import Mapping

import numpy as np

_AXIS_SIGNS = np.asarray([1, -1, -1], np.float32)
_QUATERNION_SIGNS = np.asarray([1, 1, -1, -1], np.float32)
_HARMONIC_SIGNS = np.asarray([1, -1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1], np.float32)


def half_turned(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Gaussians after half a turn about x: from x right, y down, z forward to x right, y up, z backward.

    The same turn leads back. A rotation R becomes F R F with F = diag(1, -1, -1): a Gaussian's own axes turn
    along, so that the identity stays. Each function of the harmonics is even or odd under F, so a
    coefficient keeps its value or changes its sign.

    Args:
        values: arrays by the names of `GAUSSIAN_PARAMETERS`, (N, ...) each.

    Returns:
        The arrays with means, quaternions and harmonics turned; scales and opacities are as they were.
    """
    sh = values["sh"]
    return {
        **values,
        "means": values["means"] * _AXIS_SIGNS,
        "quaternions": values["quaternions"] * _QUATERNION_SIGNS,
        "sh": sh * _HARMONIC_SIGNS[: sh.shape[1], None],
    }
