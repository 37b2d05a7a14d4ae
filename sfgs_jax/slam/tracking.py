"""Pose of a frame: GICP against the reference keyframe, from a constant-velocity start."""

from typing import NamedTuple

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax import gicp
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import TrackingConfig
from sfgs_jax.slam.state import Reference, SlamState


class Tracking(NamedTuple):
    """What tracking a frame gave.

    Attributes:
        cloud: the frame's prepared depth image.
        T_world_cam: its pose; the last known one where it was lost.
        T_previous_current: motion since the last tracked frame.
        tracked: whether the pose is known.
        new_reference: whether the frame should become the reference keyframe.
        inlier_fraction: share of its points matched in the reference.
        rmse: root mean square residual of the matched points, metres.
    """

    cloud: gicp.OrganisedCloud
    T_world_cam: jaxlie.SE3
    T_previous_current: jaxlie.SE3
    tracked: bool
    new_reference: bool
    inlier_fraction: float
    rmse: float


def track(state: SlamState, depth: Float[Array, "H W"]) -> Tracking:
    """Find the pose of a depth image. The first frame defines the world frame.

    Args:
        state: the run so far; its references, newest pose and motion are read.
        depth: (H, W) metres, 0 where missing.
    """
    config = state.config.tracking
    cloud = gicp.prepare(depth, state.camera, config=config.gicp)
    if not state.references:
        return Tracking(cloud, state.T_world_cam, se3.identity(), True, True, 1.0, 0.0)

    reference = state.references[-1]
    T_reference_last = se3.compose(se3.inverse(reference.T_world_cam), state.T_world_cam)
    result, tracked = _align(cloud, reference, T_reference_last, state.T_previous_current, config)
    inlier_fraction, rmse = float(result.inlier_fraction), float(result.rmse)
    if not tracked:
        return Tracking(cloud, state.T_world_cam, se3.identity(), False, False, inlier_fraction, rmse)
    T_world_cam = se3.compose(reference.T_world_cam, result.T_target_source)
    new_reference = _has_left(result, config)
    if new_reference:
        T_world_cam = _agree(cloud, T_world_cam, state.references, config)
    T_previous_current = se3.compose(se3.inverse(state.T_world_cam), T_world_cam)
    return Tracking(cloud, T_world_cam, T_previous_current, True, new_reference, inlier_fraction, rmse)


def _has_left(result: gicp.RegistrationResult, config: TrackingConfig) -> bool:
    """Whether the camera has moved so far that the frame should be the next reference."""
    moved = se3.log(result.T_target_source)
    return bool(
        (result.inlier_fraction < config.keyframe_inlier_fraction)
        | (jnp.linalg.norm(moved[:3]) > config.keyframe_translation)
        | (jnp.linalg.norm(moved[3:]) > config.keyframe_rotation)
    )


def _agree(
    cloud: gicp.OrganisedCloud,
    T_world_cam: jaxlie.SE3,
    references: tuple[Reference, ...],
    config: TrackingConfig,
) -> jaxlie.SE3:
    """Pose of a new reference by all the references that it overlaps, not by the last alone.

    Drift grows with every change of reference, and where the camera looks at what it saw before, an older
    reference knows the pose better. The registrations are averaged in the tangent at the pose, by the
    share of points that each explains.
    """
    total, weight = jnp.zeros(6), 0.0
    for reference in references:
        T_reference_cam = se3.compose(se3.inverse(reference.T_world_cam), T_world_cam)
        result = gicp.align(cloud, reference.cloud, T_reference_cam, config=config.gicp)
        correction = se3.log(se3.compose(se3.inverse(T_reference_cam), result.T_target_source))
        if _is_good(result, config) and jnp.linalg.norm(correction[:3]) < config.max_correction:
            total += result.inlier_fraction * correction
            weight += float(result.inlier_fraction)
    return se3.compose(T_world_cam, se3.exp(total / weight)) if weight else T_world_cam


def _align(
    cloud: gicp.OrganisedCloud,
    reference: Reference,
    T_reference_last: jaxlie.SE3,
    T_last_current: jaxlie.SE3,
    config: TrackingConfig,
) -> tuple[gicp.RegistrationResult, bool]:
    """Register from the motion model; where that fails, from no motion, then from the reference's pose."""
    starts = (
        lambda: se3.compose(T_reference_last, T_last_current),
        lambda: T_reference_last,
        se3.identity,
    )
    best = None
    for start in starts:
        result = gicp.align(cloud, reference.cloud, start(), config=config.gicp)
        if best is None or result.inlier_fraction > best.inlier_fraction:
            best = result
        if _is_good(result, config):
            return result, True
    assert best is not None
    return best, False


def _is_good(result: gicp.RegistrationResult, config: TrackingConfig) -> bool:
    finite = jnp.all(jnp.isfinite(result.T_target_source.wxyz_xyz))
    return bool(finite & (result.inlier_fraction >= config.min_inlier_fraction))
