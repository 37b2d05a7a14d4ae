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
        state: the run so far; its reference, newest pose and motion are read.
        depth: (H, W) metres, 0 where missing.
    """
    config = state.config.tracking
    cloud = gicp.prepare(depth, state.camera, config=config.gicp)
    if state.reference is None:
        return Tracking(cloud, state.T_world_cam, se3.identity(), True, True, 1.0, 0.0)

    T_reference_last = se3.compose(se3.inverse(state.reference.T_world_cam), state.T_world_cam)
    result, tracked = _align(cloud, state.reference, T_reference_last, state.T_previous_current, config)
    if not tracked:
        return Tracking(
            cloud,
            state.T_world_cam,
            se3.identity(),
            False,
            False,
            float(result.inlier_fraction),
            float(result.rmse),
        )
    T_reference_cam = result.T_target_source
    moved = jnp.abs(se3.log(T_reference_cam))
    return Tracking(
        cloud=cloud,
        T_world_cam=se3.compose(state.reference.T_world_cam, T_reference_cam),
        T_previous_current=se3.compose(se3.inverse(T_reference_last), T_reference_cam),
        tracked=True,
        new_reference=bool(
            (result.inlier_fraction < config.keyframe_inlier_fraction)
            | (jnp.linalg.norm(moved[:3]) > config.keyframe_translation)
            | (jnp.linalg.norm(moved[3:]) > config.keyframe_rotation)
        ),
        inlier_fraction=float(result.inlier_fraction),
        rmse=float(result.rmse),
    )


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
