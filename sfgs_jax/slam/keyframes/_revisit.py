"""Return to a keyframe: a camera that stays in a place adds no keyframes there once it has enough of them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig, TrackingConfig
from sfgs_jax.slam.frontend import Found, TrackInfo, as_reference, needs_keyframe
from sfgs_jax.slam.frontend._joint_registration import register
from sfgs_jax.slam.frontend._pose_source import supports_edge
from sfgs_jax.slam.keyframes._covariances import motion_covariance
from sfgs_jax.slam.keyframes._edges import CONSISTENT
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._maps import maps_of
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import Reference, Tracker, TrackerParams, reference_at, with_reference


def revisited(params: TrackerParams, found: Found, graph: KeyframeGraph, config: GraphConfig) -> Found:
    """Track on in a keyframe from before, where a frame became a keyframe that would add nothing.

    It adds nothing if a keyframe is near that shows the same, and if both agree within the noise of their
    registrations. A larger disagreement is drift, which a new keyframe's edges will mend.

    Args:
        params: parameters of tracking.
        found: the tracker after the frame, and what happened to it.
        graph: keyframes before the frame.
        config: settings.

    Returns:
        Both, changed where a keyframe was returned to.
    """
    tracker, info = found.tracker, found.info
    wanted = config.enabled and config.return_to_keyframes and params.depth_correction is None
    added = bool(info.new_keyframe) and not bool(info.bridged) and not found.begins_map
    if not (wanted and added and graph.keyframes):
        return found
    number = _nearest(graph, info, params.config, config)
    if number is None:
        return found
    target = as_reference(params, graph, number)
    expected = se3.compose(se3.inverse(graph.pose(number)), info.T_world_cam)
    again = register(params, reference_at(tracker, tracker.current).features, target.features, expected)
    off = np.asarray(se3.log(se3.compose(se3.inverse(expected), again.T_target_source)), np.float64)
    with_keypoints = params.config.features.kind != "none"
    if not supports_edge(again, float(np.abs(off).max()), config, with_keypoints=with_keypoints):
        return found
    agrees = _agrees(params, graph, (info.registration, again), off)
    if bool(needs_keyframe(again, params.config)) or not agrees:
        return found
    tracker, info = return_to_keyframe(tracker, info, target, again)
    return found._replace(tracker=tracker, info=info)


def _nearest(
    graph: KeyframeGraph, found: TrackInfo, tracking: TrackingConfig, config: GraphConfig
) -> int | None:
    """Number of the keyframe whose camera was nearest to a frame's, if that is near enough to track in."""
    poses = se3.matrices_of(np.concatenate([graph.poses, np.asarray(found.T_world_cam.wxyz_xyz)[None]]))
    keyframes, frame = poses[:-1], poses[-1]
    distance = np.linalg.norm(keyframes[:, :3, 3] - frame[:3, 3], axis=1)
    # The cosine of the whole turn: one about the line of sight leaves the image as well.
    cosine = (np.einsum("nij,ij->n", keyframes[:, :3, :3], frame[:3, :3]) - 1) / 2
    angle = np.arccos(np.clip(cosine, -1, 1))
    left = np.maximum(distance / tracking.keyframe_translation, angle / tracking.keyframe_rotation)
    maps = maps_of(graph)
    left[maps != maps[int(found.reference)]] = np.inf
    left[int(found.reference)] = np.inf
    if not config.loops:
        left[: max(0, len(left) - config.loop_gap)] = np.inf
    nearest = int(np.argmin(left))
    return nearest if left[nearest] < 1 else None


def _agrees(
    params: TrackerParams,
    graph: KeyframeGraph,
    registrations: tuple[Registration, Registration],
    off: Float[np.ndarray, "6"],
) -> bool:
    """True if two registrations of a frame differ by no more than their noise."""
    covariance = sum(
        motion_covariance(found, graph.noise, params.config.motion_model_sigma) for found in registrations
    )
    return bool(off @ np.linalg.solve(covariance, off) < CONSISTENT)


@jax.jit
def return_to_keyframe(
    tracker: Tracker,
    found: TrackInfo,
    reference: Reference,
    again: Registration,
) -> tuple[Tracker, TrackInfo]:
    """A keyframe from before as the reference, in the slot of the one that the newest frame had become.

    Args:
        tracker: after a frame that became a keyframe.
        found: what happened to the frame.
        reference: the keyframe from before.
        again: registration of the frame to it.
    """
    T = again.T_target_source
    # One step back in the ring, so that the keyframe takes the place of the frame.
    tracker = eqx.tree_at(lambda t: t.current, tracker, tracker.current - 1)
    tracker = with_reference(tracker, reference)
    tracker = eqx.tree_at(
        lambda t: (t.num_keyframes, t.T_reference_cam, t.last_registration, t.has_last),
        tracker,
        (tracker.num_keyframes - 1, T, again, jnp.asarray(True)),
    )
    pose, number = jnp.asarray(reference.pose), reference.keyframe
    told = (se3.compose(jaxlie.SE3(pose), T), T, again.source, again, number, jnp.asarray(False))
    return tracker, eqx.tree_at(
        lambda i: (
            i.T_world_cam,
            i.T_reference_cam,
            i.source,
            i.registration,
            i.reference,
            i.new_keyframe,
        ),
        found,
        told,
    )
