"""Localisation of a frame: the ladder from the last pose to any keyframe.

1. `track`: the motion model, the last pose, and the frame before, in one compiled program.
2. Relocalisation: registration to the keyframes whose images look most alike; only many matches count.
3. Search by the surface: registration to the reference and the frame before from turned guesses.

Steps 2 and 3 run only where `track` has lost the frame.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.geometry import Frame, se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend._frame_features import host_keypoints
from sfgs_jax.slam.frontend._image_signature import similarities
from sfgs_jax.slam.frontend._joint_registration import register
from sfgs_jax.slam.frontend._pose_source import supports_relocalisation
from sfgs_jax.slam.frontend._recorrection import features_in_use
from sfgs_jax.slam.frontend._track import TrackInfo, allowed_sources, rectified_last, settle, track
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._tracker import Tracker, TrackerParams, reference_at, with_reference
from sfgs_jax.superfeats import mean_grey

_TURNS = np.concatenate([np.eye(6)[3:5], -np.eye(6)[3:5]]).astype(np.float32)
"""Tangents of unit rotations about the camera's x and y axes, both ways."""


class Localised(NamedTuple):
    """A frame that `track` had lost, found again.

    Attributes:
        keyframe: number of the keyframe that it was registered to.
        features: of that keyframe.
        pose: its `T_world_cam` as wxyz_xyz.
        registration: the registration.
        bridged: whether that keyframe is the frame before, still to be inserted.
        relocalised: whether the frame was found by its looks rather than near its last pose.
    """

    keyframe: int
    features: FrameFeatures
    pose: Float[Array | np.ndarray, "7"]
    registration: Registration
    bridged: bool
    relocalised: bool


def find_frame(
    params: TrackerParams,
    tracker: Tracker,
    frame: Frame,
    since: float,
    graph: KeyframeGraph,
    config: GraphConfig,
) -> tuple[Tracker, TrackInfo, bool]:
    """Go up the ladder with a frame until it is found.

    Args:
        params: parameters of tracking.
        tracker: before the frame.
        frame: colour image and depth.
        since: seconds since the frame before; not positive or not finite if unknown.
        graph: keyframes to look in.
        config: settings of relocalisation.

    Returns:
        The tracker after the frame, what happened to it, and whether it was found by its looks.
    """
    elapsed = np.float32(since if 0 < since < np.inf else 0)
    keypoints = host_keypoints(params, frame)
    after, info = track(params, tracker, mean_grey(frame.rgb), frame.depth, elapsed, keypoints)
    if int(info.source) != PoseSource.LOST:
        return after, info, False
    found = localise(params, tracker, info.features, graph, config)
    if found is None:
        return after, info, False
    return *place(params, after, info.features, found), found.relocalised


def localise(
    params: TrackerParams,
    tracker: Tracker,
    features: FrameFeatures,
    graph: KeyframeGraph,
    config: GraphConfig,
) -> Localised | None:
    """Find a frame that `track` has lost.

    Args:
        params: parameters of tracking.
        tracker: before the frame.
        features: of the frame.
        graph: keyframes to look in.
        config: settings of relocalisation.
    """
    if not graph.keyframes:
        return None
    return relocalise(params, features, graph, config) or search_by_surface(params, tracker, features)


def relocalise(
    params: TrackerParams, features: FrameFeatures, graph: KeyframeGraph, config: GraphConfig
) -> Localised | None:
    """Look for a frame in the keyframes whose images look most like it.

    Args:
        params: parameters of tracking.
        features: of the frame.
        graph: keyframes to look in.
        config: settings.
    """
    if not np.asarray(features.keypoints.features.valid).any():
        return None
    alike = keyframe_similarities(graph.keyframes, features)
    order = np.argsort(-alike, kind="stable")[: config.relocalisation_candidates]
    for number in map(int, order):
        target = features_in_use(params, graph.keyframes[number])
        found = register(params, features, target, se3.identity())
        if supports_relocalisation(found, config):
            pose = graph.poses[number]
            return Localised(number, target, pose, found, False, True)
    return None


def search_by_surface(params: TrackerParams, tracker: Tracker, features: FrameFeatures) -> Localised | None:
    """Look for a frame by its surface near the last pose, from guesses turned up, down and sideways.

    Keypoints need no start near the pose. The surface does, and the motion model has failed to give one.

    Args:
        params: parameters of tracking.
        tracker: before the frame.
        features: of the frame.
    """
    allowed, config = allowed_sources(tracker, params.config), params.config
    if not config.use_surface or not bool(allowed.surface):
        return None
    bridged = bool(tracker.has_last)
    target = rectified_last(params, tracker) if bridged else reference_at(tracker, tracker.current)
    pose = tracker.T_world_cam.wxyz_xyz if bridged else tracker.reference_poses[tracker.current]
    keyframe = tracker.num_keyframes if bridged else tracker.reference_keyframes[tracker.current]
    for turn in config.search_angle * _TURNS:
        start = se3.exp(turn) if bridged else se3.compose(tracker.T_reference_cam, se3.exp(turn))
        found = register(params, features, target, start, allowed)
        # Nothing confirms the guess where the surface leaves a direction free.
        if int(found.source) not in (PoseSource.LOST, PoseSource.MOTION_MODEL):
            return Localised(int(keyframe), target, pose, found, bridged, False)
    return None


def keyframe_similarities(keyframes: Sequence[Keyframe], features: FrameFeatures) -> np.ndarray:
    """(n,) similarity of each keyframe's image to a frame's, at most 1.

    Args:
        keyframes: the n keyframes.
        features: of the frame.
    """
    signatures = np.stack([np.asarray(k.features.keypoints.signature) for k in keyframes])
    return similarities(signatures, np.asarray(features.keypoints.signature))


def place(
    params: TrackerParams, tracker: Tracker, features: FrameFeatures, found: Localised
) -> tuple[Tracker, TrackInfo]:
    """The tracker with a frame that was found again.

    Args:
        params: parameters of tracking.
        tracker: after the frame was lost.
        features: of the frame.
        found: where it was found.
    """
    keyframe, relocalised = np.asarray(found.keyframe, np.int32), np.asarray(found.relocalised)
    bridged = np.asarray(found.bridged)
    return _place(
        params,
        tracker,
        features,
        found.features,
        found.pose,
        keyframe,
        found.registration,
        relocalised,
        bridged,
    )


@jax.jit
def _place(
    params: TrackerParams,
    tracker: Tracker,
    features: FrameFeatures,
    reference: FrameFeatures,
    pose: Array,
    keyframe: Array,
    found: Registration,
    relocalised: Array,
    bridged: Array,
) -> tuple[Tracker, TrackInfo]:
    before = tracker.T_world_cam
    # The motion by which the reference was rectified is not kept with keyframes.
    unknown = jax.tree.map(jnp.zeros_like, tracker.last_motion)
    tracker = with_reference(tracker, reference, unknown, jnp.asarray(pose), keyframe)
    count = jnp.maximum(tracker.num_keyframes, keyframe + 1)
    tracker = eqx.tree_at(lambda t: t.num_keyframes, tracker, count)
    tracker, info = settle(
        params, tracker, features, found, before=before, source=found.source, relocalised=relocalised
    )
    return tracker, eqx.tree_at(lambda i: i.bridged, info, bridged)
