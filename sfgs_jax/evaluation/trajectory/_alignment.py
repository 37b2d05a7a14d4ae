"""Least-squares alignment of two sets of corresponding points."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import Trajectory


@dataclass(frozen=True)
class Alignment:
    """Similarity or rigid motion `x -> scale * R x + t` from the source's frame to the target's.

    Attributes:
        T_target_source: rotation and translation, float64.
        scale: factor on the source's coordinates, applied before the motion; 1 for a rigid alignment.
    """

    T_target_source: Float[np.ndarray, "4 4"]
    scale: float

    def transform(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Source points in the target's frame."""
        return self.scale * points @ self.T_target_source[:3, :3].T + self.T_target_source[:3, 3]

    def transform_poses(self, trajectory: Trajectory) -> Trajectory:
        """The trajectory with its poses in the target's world frame; rotations stay rotations."""
        poses = self.T_target_source @ trajectory.poses
        poses[:, :3, 3] = self.transform(trajectory.positions)
        return Trajectory(trajectory.timestamps, poses)


@checked
def align_points(
    source: Float[np.ndarray, "n 3"], target: Float[np.ndarray, "n 3"], *, with_scale: bool = False
) -> Alignment:
    """Least-squares motion between corresponding points, by Umeyama's method.

    Points on one line, or all at one place, leave a rotation open. Then the result is one of the motions with
    the smallest error, which is the same for all. The scale of points that don't move is 1.

    Source: Umeyama, Least-squares estimation of transformation parameters between two point patterns, 1991.

    Args:
        source: points to be moved, at least one.
        target: their counterparts.
        with_scale: also estimate a scale.

    Raises:
        InputError: there is no point, or one is not finite.
    """
    if not len(source) or not (np.isfinite(source).all() and np.isfinite(target).all()):
        raise InputError("source and target of align_points should be finite points, metres, at least one.")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    x, y = source - mean_source, target - mean_target
    u, singular_values, vt = np.linalg.svd(y.T @ x / len(x))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    variance = float(np.mean(np.sum(x * x, axis=1)))
    scale = float(singular_values @ signs) / variance if with_scale and variance > 0 else 1.0
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = mean_target - scale * rotation @ mean_source
    return Alignment(matrix, scale)
