"""Rotations on the host, in float64, for files and graphs, where float32 would cost digits."""

import numpy as np

from sfgs_jax.arrays import checked


@checked
def quaternions_from_rotations(rotations: np.ndarray) -> np.ndarray:
    """(N, 4) unit quaternions wxyz, w >= 0, of (N, 3, 3) rotation matrices, in float64.

    Source: Shepperd's method, by the largest of the four candidate components.
    """
    r = np.asarray(rotations, np.float64)
    trace = np.trace(r, axis1=-2, axis2=-1)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    squares = np.concatenate([(1 + trace)[:, None], 1 + 2 * diagonal - trace[:, None]], axis=1)
    # products[i, j] = 4 q_i q_j, so the row of the largest q_i is the quaternion up to scale.
    products = np.empty((len(r), 4, 4))
    products[:, range(4), range(4)] = squares
    for i, (a, b) in enumerate([(2, 1), (0, 2), (1, 0)], start=1):
        products[:, 0, i] = products[:, i, 0] = r[:, a, b] - r[:, b, a]
    for i, j in [(0, 1), (0, 2), (1, 2)]:
        products[:, i + 1, j + 1] = products[:, j + 1, i + 1] = r[:, i, j] + r[:, j, i]
    rows = products[np.arange(len(r)), np.argmax(squares, axis=1)]
    q = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    return np.where(q[:, :1] < 0, -q, q)


@checked
def rotations_from_quaternions(quaternions: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotation matrices of (N, 4) quaternions wxyz of any positive length, in float64."""
    q = np.asarray(quaternions, np.float64)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        axis=-2,
    )


@checked
def rotation_vectors(rotations: np.ndarray) -> np.ndarray:
    """(N, 3) axes times angles, radians from 0 to pi, of (N, 3, 3) rotation matrices, in float64."""
    q = quaternions_from_rotations(rotations)
    sine = np.linalg.norm(q[:, 1:], axis=1, keepdims=True)
    # arccos of the scalar part would lose half the digits of a small angle.
    angle = 2 * np.arctan2(sine, q[:, :1])
    return np.where(sine > 0, angle / np.where(sine > 0, sine, 1), 2) * q[:, 1:]


@checked
def slerp(start: np.ndarray, end: np.ndarray, fraction: np.ndarray) -> np.ndarray:
    """Spherical linear interpolation of rotations, on the shortest arcs.

    Source: Shoemake, Animating rotation with quaternion curves (SIGGRAPH 1985).

    Args:
        start: (N, 3, 3) rotation matrices at fraction 0.
        end: (N, 3, 3) rotation matrices at fraction 1.
        fraction: (N, 1) from 0 to 1.

    Returns:
        (N, 3, 3) rotation matrices in float64.
    """
    qa, qb = quaternions_from_rotations(start), quaternions_from_rotations(end)
    cosine = np.sum(qa * qb, axis=1, keepdims=True)
    qb = np.where(cosine < 0, -qb, qb)
    angle = np.arccos(np.clip(np.abs(cosine), 0, 1))
    small = angle < 1e-6
    sine = np.where(small, 1, np.sin(angle))
    weight_a = np.where(small, 1 - fraction, np.sin((1 - fraction) * angle) / sine)
    weight_b = np.where(small, fraction, np.sin(fraction * angle) / sine)
    return rotations_from_quaternions(weight_a * qa + weight_b * qb)
