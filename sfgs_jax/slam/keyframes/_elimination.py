"""Elimination of the pose from the normal equations of a registration."""

import numpy as np
from jaxtyping import Float


def by_pose(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "6 m"]:
    """Derivative of the pose's best value by the other unknowns and the residual, with its sign reversed.

    Args:
        matrix: normal matrix of the pose, the other unknowns and the residual.
    """
    # A pose that nothing fixes takes nothing away.
    pose = matrix[:6, :6]
    regular = pose + (1e-6 * np.trace(pose) + 1e-9) * np.eye(len(pose))
    return np.linalg.solve(regular, matrix[:6, 6:])


def without_pose(matrix: Float[np.ndarray, "n n"]) -> Float[np.ndarray, "m m"]:
    """Normal matrix of the other unknowns and the residual, with the pose eliminated.

    Args:
        matrix: normal matrix of the pose, the other unknowns and the residual.
    """
    return matrix[6:, 6:] - matrix[6:, :6] @ by_pose(matrix)
