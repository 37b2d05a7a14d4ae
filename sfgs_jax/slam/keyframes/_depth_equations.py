"""Equations of the distortion of depth after a registration of two keyframes.

A camera's distortion of depth moves with the camera. So two surfaces that a motion lays on each other still
bend against each other, and no other motion removes that. Each registration has its normal equations of the
pose and the offsets, with the pose eliminated. The offsets are the same for all frames, so the sum of these
equations is all there is to keep. The same equations say how the motion changes with the offsets.
"""

from functools import reduce

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import dot
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import grid_shares
from sfgs_jax.slam.frontend._registration_rows import keypoint_rows
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import BY_KEYPOINTS, PoseSource, Registration
from sfgs_jax.slam.state._tracker import TrackerParams

_DECIMATION = 2
"""Every second row and column of the points aligned: neighbours share most of their pixels."""

_MIN_FLATNESS = 0.9
"""Least cosine between a point's normal and those two pixels around it. The mean of a window over a crease
lies beside the surface, the more the farther it is. In a room seen without error that looked like one of
4 mm at 2 m, and this threshold leaves 0.1 mm. With noise those from 0.7 to 0.97 leave up to 0.9 mm."""


class DepthEquations(eqx.Module):
    """A registration's equations of the G offsets, on the host.

    Attributes:
        information: (G, G) by the surface, with the pose eliminated, m².
        vector: (G,) right-hand side, for the difference from the offsets in use, m.
        sensitivity: (6, G) derivative of the motion's tangent by the offsets.
    """

    information: Float[np.ndarray, "G G"]
    vector: Float[np.ndarray, " G"]
    sensitivity: Float[np.ndarray, "6 G"]


def depth_equations(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> DepthEquations:
    """Equations of the offsets after a registration.

    Args:
        params: parameters of tracking; both frames have its correction.
        source: the frame that was registered.
        target: the frame that it was registered to.
        found: the registration.
    """
    surface, keypoints = (np.asarray(x, np.float64) for x in _normal_matrices(params, source, target, found))
    taken = np.linalg.solve(_regular(surface[:6, :6]), surface[:6, 6:])
    left = surface[6:, 6:] - surface[6:, :6] @ taken
    kind = int(found.source)
    both = surface * (kind != PoseSource.KEYPOINTS) + keypoints * (kind in BY_KEYPOINTS)
    sensitivity = -np.linalg.solve(_regular(both[:6, :6]), both[:6, 6:-1])
    return DepthEquations(left[:-1, :-1], -left[:-1, -1], sensitivity)


def _regular(matrix: np.ndarray) -> np.ndarray:
    """A matrix that has an inverse: a pose that nothing fixes takes nothing away."""
    return matrix + (1e-6 * np.trace(matrix) + 1e-9) * np.eye(len(matrix))


@jax.jit
def _normal_matrices(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> tuple[Float[Array, "n n"], Float[Array, "n n"]]:
    """Normal matrices by surface and by keypoints, n = 6 + G + 1: of pose, offsets and residual."""
    matrices = []
    for rows, weight in (
        _surface_rows(params, source, target, found),
        _keypoint_rows(params, source, target, found),
    ):
        rows = jnp.where(weight[None] > 0, rows, 0)
        matrices.append(jnp.matmul(rows * weight[None], rows.T, precision=Precision.HIGHEST))
    return matrices[0], matrices[1]


def _surface_rows(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> tuple[Float[Array, "n N"], Float[Array, " N"]]:
    """Distances along the normals of a sample of the finest level, with their derivatives, and weights."""
    T, config = found.T_target_source, params.config.gicp
    problem = gicp.level_problem(
        source.cloud.levels, target.cloud.levels, None, 0, config, decimation=_DECIMATION
    )
    pairs, points = problem.correspondences(T), problem.source.points
    mean = problem.source.normals + pairs.normals
    normals = mean * lax.rsqrt(jnp.where(pairs.valid, dot(mean, mean), 1))[None]
    residual = jnp.where(pairs.valid, dot(points - pairs.points, normals), 0)
    weight = problem.robust_weights(pairs) * _flat(source.cloud.levels[0], len(residual))
    excess = jnp.sum(weight * residual**2) / jnp.maximum(jnp.sum(weight * pairs.variance), 1e-12)

    # Taken between the two surfaces. At the measured points the derivative would have their noise in it. Then
    # offsets that shrink the scene, and all noise with it, would seem to fit better.
    inside = jnp.asarray([[0], [0], [1]], points.dtype)
    between = jnp.where(pairs.valid[None], (points + pairs.points) / 2, inside)
    camera, seen = source.cloud.levels[0].camera, se3.transform(T, between.T)
    from_target = jnp.matmul(se3.rotation_matrix(T).T, seen.T, precision=Precision.HIGHEST)
    by_source = grid_shares(camera.project(between.T), camera) * (dot(between, normals) * between[2])[None]
    by_target = grid_shares(camera.project(seen), camera) * (dot(from_target, normals) * seen[:, 2])[None]
    rows = [normals, jnp.cross(points, normals, axis=0), by_source - by_target, residual[None]]
    return jnp.concatenate(rows), weight / (problem.redundancy * jnp.maximum(excess, 0.01))


def _flat(level: gicp.OrganisedLevel, count: int) -> Float[Array, " N"]:
    """1 where the surface around a point is flat, else 0; of every n-th row and column, N in all."""
    normals = jnp.pad(level.normals, ((2, 2), (2, 2), (0, 0)))
    height, width = level.valid.shape
    steps = ((0, 0), (0, 4), (4, 0), (4, 4), (0, 2), (2, 0), (2, 4), (4, 2))
    around = [normals[v : v + height, u : u + width] for v, u in steps]
    least = reduce(jnp.minimum, [jnp.sum(level.normals * n, axis=-1) for n in around])
    stride = round((least.size / count) ** 0.5)
    return (least > _MIN_FLATNESS)[::stride, ::stride].reshape(-1).astype(least.dtype)


def _keypoint_rows(
    params: TrackerParams, source: FrameFeatures, target: FrameFeatures, found: Registration
) -> tuple[Float[Array, "n N"], Float[Array, " N"]]:
    """Reprojection errors of the matches that the motion explains, with their derivatives, and weights."""
    T, matched, camera = found.T_target_source, found.matched, params.camera
    rows = keypoint_rows(params, source, target, T, matched)
    pixels, seen = source.keypoints.features.keypoints, target.keypoints.points[matched.index]
    turned = jnp.matmul(se3.rotation_matrix(T).T, seen.T, precision=Precision.HIGHEST)
    moved = jnp.sum(rows.at.point_jacobian * (turned * seen[:, 2][None])[None], axis=1)
    target_pixels = target.keypoints.features.keypoints[matched.index]
    by_offsets = moved[:, None] * grid_shares(target_pixels, camera)[None]
    measured = jnp.where(source.keypoints.depth > 0, 1 / params.config.features.inverse_depth_sigma, 0)
    by_offsets = by_offsets.at[2].add(measured[None] * grid_shares(pixels, camera))
    all_rows = jnp.concatenate([rows.at.pose_jacobian, by_offsets, rows.at.residual[:, None]], axis=1)
    return jnp.moveaxis(all_rows, 1, 0).reshape(all_rows.shape[1], -1), rows.weights
