"""Estimate of the times of the camera's rows, while tracking.

If the times are wrong, a registration keeps residuals that no pose removes. Rows bend against each other, and
keypoints and surface tell of different motions. So each registration has its normal equations of the pose
and the times, with the pose eliminated. The times are the same in all frames, so the sum of these equations
is all there is to keep: an information filter.

Errors of depth bend surfaces too, and a depth camera beside its place moves otherwise than the keypoints.
If they are estimated, the equations have them as unknowns. Left out, they would pass for a delay. In a room
with a Kinect's faults the estimate is then 13 ms off after eight frames, with a deviation of 2.5.

The reference was rectified by the times as they were thought to be then, and moved in its own way. Both
enter: a delay, for example, shows where the camera does not move like it did in the reference.
"""

from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.arrays import dot, gauss_jordan
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import row_places, velocities
from sfgs_jax.slam.frontend._depth_derivatives import ByDepth, keypoints_by_depth, surface_by_depth
from sfgs_jax.slam.frontend._rectification import with_depth_in_time
from sfgs_jax.slam.frontend._registration_rows import keypoint_rows, surface_rows
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._tracker import TrackerParams


class _Registered(NamedTuple):
    """A registration and what it was found from.

    Attributes:
        params: parameters of tracking.
        source: the frame, with the depth of its keypoints in time.
        target: the reference, rectified.
        found: the registration.
        moving: motion of the source, and the times that were used for it.
        twist: the target's motion per second when it was rectified, in source coordinates.
    """

    params: TrackerParams
    source: FrameFeatures
    target: FrameFeatures
    found: Registration
    moving: gicp.RowMotion
    twist: Float[Array, "6"]

    @property
    def depth_errs(self) -> bool:
        """True if errors of depth are among the unknowns."""
        return len(self.params.depth_root) > 0


class _Rows(eqx.Module):
    """Whitened residuals and their derivatives.

    Attributes:
        residual: (N,) at the pose and the times found.
        pose: (6, N) by the tangent of T_target_source.
        source: (3, N) by the times, through the source.
        target: (3, N) by the times, through the rectification of the target.
        depth: (G, N) by the errors of depth.
        weight: (N,) of independent measurements.
    """

    residual: Float[Array, " N"]
    pose: Float[Array, "6 N"]
    source: Float[Array, "3 N"]
    target: Float[Array, "3 N"]
    depth: Float[Array, "G N"]
    weight: Float[Array, " N"]


def timing_equations(
    params: TrackerParams,
    source: FrameFeatures,
    target: FrameFeatures,
    found: Registration,
    moving: gicp.RowMotion,
    target_moving: gicp.RowMotion,
) -> tuple[Float[Array, "n n"], Float[Array, " n"]]:
    """Normal equations of the times and depth's G errors after a registration, with the pose eliminated.

    The unknowns are those of a `TimingInformation`, n = 3 + G.

    Args:
        params: parameters of tracking.
        source: the frame that was registered, as it was read.
        target: the reference, rectified.
        found: the registration.
        moving: motion of the source, and the times that were used for it.
        target_moving: the same of the target, when it was rectified.

    Returns:
        Information and right-hand side, of times 1 / s² and 1 / s.
    """
    source = replace(source, keypoints=with_depth_in_time(source, params.camera, moving))
    adjoint = se3.adjoint(se3.inverse(found.T_target_source))
    twist = jnp.matmul(adjoint, target_moving.twist, precision=Precision.HIGHEST)
    registered = _Registered(params, source, target, found, moving, twist)
    rows = [_keypoint_rows(registered)] if params.config.features.kind != "none" else []
    rows += [_surface_rows(registered)] if params.config.use_surface else []
    all_rows = jax.tree.map(lambda *parts: jnp.concatenate(parts, axis=-1), *rows)
    start, used = params.timing.vector, (moving.timing.vector, target_moving.timing.vector)
    # The residual is linear in the times: this is it for those that the estimate started from.
    residual = all_rows.residual + (start - used[0]) @ all_rows.source + (start - used[1]) @ all_rows.target
    columns = jnp.concatenate(
        [all_rows.pose, all_rows.source + all_rows.target, all_rows.depth, residual[None]]
    )
    total = jnp.matmul(columns * all_rows.weight[None], columns.T, precision=Precision.HIGHEST)
    # Scaled before it is factorised, for float32; a pose that nothing fixes takes nothing away.
    scale = lax.rsqrt(jnp.maximum(jnp.diagonal(total), 1e-12))
    total = total * scale[:, None] * scale[None, :]
    _, taken = gauss_jordan(total[:6] + 1e-5 * jnp.eye(6, len(total), dtype=total.dtype))
    left = total[6:, 6:] - jnp.matmul(total[6:, :6], taken, precision=Precision.HIGHEST)
    left = left / (scale[6:, None] * scale[None, 6:])
    return left[:-1, :-1], -left[:-1, -1]


def _surface_rows(registered: _Registered) -> _Rows:
    """Distances along the normals, of a sample of the finest level."""
    params, source, target, found, moving, twist = registered
    camera, T = source.cloud.levels[0].camera, found.T_target_source
    rows = surface_rows(params, source, target, T, moving)

    # Both at one point: two points of a pair are apart by their noise, of which the residual is made as well.
    def by_times(pixels: Float[Array, "N 2"], twist: Float[Array, "6"]) -> Array:
        speed = dot(velocities(rows.points, twist), rows.normals)
        share = row_places(pixels[:, 1], camera.height)
        return jnp.stack([speed, jnp.zeros_like(speed), speed * share])

    seen = camera.project(se3.transform(T, rows.targets.T))
    by_source = by_times(camera.project(rows.points.T), moving.twist)
    by_target = -by_times(seen, twist)
    # A surface that does not fit tells of no time.
    fits = found.source != PoseSource.KEYPOINTS
    weight = jnp.where(fits, rows.weight, 0)
    by_depth = [surface_by_depth(rows, weight, camera, T)] if registered.depth_errs else []
    return _Rows(rows.residual, rows.pose, by_source, by_target, _columns(by_depth, weight), weight)


def _keypoint_rows(registered: _Registered) -> _Rows:
    """Reprojection errors of the matches that the motion explains."""
    params, source, target, found, moving, twist = registered
    T, matched, camera = found.T_target_source, found.matched, params.camera
    rows = keypoint_rows(params, source, target, T, matched, moving)

    def by_times(pixels: Float[Array, "k 2"], twist: Float[Array, "6"]) -> Array:
        share = row_places(pixels[:, 1], camera.height)
        speed = rows.by_points(velocities(rows.points, twist) * share[None])
        return jnp.stack([jnp.zeros_like(speed), speed, jnp.zeros_like(speed)])

    by_source = -by_times(matched.pixels, moving.twist)
    by_target = by_times(target.keypoints.features.keypoints[matched.index], twist)
    # Keypoints that took no part in the pose are wrong, or contradict the surface for another reason.
    weights = jnp.where(found.by_keypoints, rows.weights, 0)
    by_depth = keypoints_by_depth(rows, source, target, matched, camera, T) if registered.depth_errs else []
    return _Rows(rows.residual, rows.pose, by_source, by_target, _columns(by_depth, weights), weights)


def _columns(parts: list[ByDepth], weight: Float[Array, " N"]) -> Float[Array, "G N"]:
    """Derivatives by depth's errors, one part after the other; no rows where there are no such errors."""
    if not parts:
        return jnp.zeros((0, len(weight)), weight.dtype)
    return jnp.where(weight > 0, jnp.concatenate([jnp.concatenate(part) for part in parts], axis=1), 0)
