"""Localisation of a frame: the ladder from the last pose to any keyframe, and to a map of its own.

1. `track`: the motion model, the last pose, and the frame before, in one compiled program.
2. Relocalisation: registration to the keyframes whose images look most alike; only many matches count. Out of
   reach of the last pose, several frames in a row have to find the same place.
3. Search by the surface: registration to the reference and the frame before from turned guesses.
4. Another map: after many frames in a row that fit no known place, the newest begins one.

Steps 2 to 4 run only where `track` has lost the frame.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Frame, se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend._frame_features import host_keypoints
from sfgs_jax.slam.frontend._image_signature import most_similar
from sfgs_jax.slam.frontend._joint_registration import register
from sfgs_jax.slam.frontend._new_map import begin_map, frames_until_new_map, with_unknown_place
from sfgs_jax.slam.frontend._pose_source import supports_relocalisation
from sfgs_jax.slam.frontend._recorrection import as_reference
from sfgs_jax.slam.frontend._suspicion import NO_SUSPICION, is_reachable, strengthened, undisputed
from sfgs_jax.slam.frontend._track import TrackInfo, allowed_sources, last_as_reference, settle, track
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._registration import PoseSource, Registration
from sfgs_jax.slam.state._tracker import (
    Reference,
    Suspicion,
    Tracker,
    TrackerParams,
    reference_at,
    with_reference,
)
from sfgs_jax.superfeats import mean_grey

_TURNS = np.concatenate([np.eye(6)[3:5], -np.eye(6)[3:5]]).astype(np.float32)
"""Tangents of unit rotations about the camera's x and y axes, both ways."""


class Localised(NamedTuple):
    """A frame that `track` had lost, found again.

    Attributes:
        reference: the keyframe that it was registered to.
        registration: the registration.
        bridged: whether that keyframe is the frame before, still to be inserted.
        relocalised: whether the frame was found by its looks rather than near its last pose.
    """

    reference: Reference
    registration: Registration
    bridged: bool
    relocalised: bool


class Found(NamedTuple):
    """A frame that went up the ladder.

    Attributes:
        tracker: after the frame.
        info: what happened to it.
        by_looks: whether it was found by its looks.
        begins_map: whether it is the first frame of another map.
    """

    tracker: Tracker
    info: TrackInfo
    by_looks: bool = False
    begins_map: bool = False


def begin_tracking(
    params: TrackerParams, tracker: Tracker, frame: Frame, elapsed: float
) -> tuple[Tracker, TrackInfo]:
    """Take the first step of the ladder; its results are under way.

    Args:
        params: parameters of tracking.
        tracker: before the frame.
        frame: colour image and depth.
        elapsed: seconds since the frame before, 0 if unknown.
    """
    keypoints = host_keypoints(params, frame)
    return track(params, tracker, mean_grey(frame.rgb), frame.depth, np.float32(elapsed), keypoints)


def find_frame(
    params: TrackerParams,
    tracker: Tracker,
    tracked: tuple[Tracker, TrackInfo],
    frame: Frame,
    elapsed: float,
    graph: KeyframeGraph,
    config: GraphConfig,
) -> Found:
    """Go up the rest of the ladder with a frame until it is found.

    Args:
        params: parameters of tracking.
        tracker: before the frame.
        tracked: what its first step found, by `begin_tracking`.
        frame: colour image and depth.
        elapsed: seconds since the frame before, 0 if unknown.
        graph: keyframes to look in.
        config: settings of relocalisation.
    """
    after, info = tracked
    if int(info.source) != PoseSource.LOST:
        return Found(after, info)
    if not graph.keyframes:
        return Found(after, info)
    place_of, suspicion = relocalise(params, after, info.features, graph, config, seconds=elapsed)
    place_of = place_of or search_by_surface(params, tracker, info.features)
    if place_of is not None:
        return Found(*place(params, after, info.features, place_of), by_looks=place_of.relocalised)
    suspicion = with_unknown_place(tracker.suspicion, suspicion, info.features, config)
    after = eqx.tree_at(lambda t: t.suspicion, after, jax.device_put(suspicion))
    if 0 < frames_until_new_map(after, graph, config) <= int(suspicion.unknown):
        begun, first = begin_map(params, after, frame, graph)
        return Found(begun, first, begins_map=bool(first.new_keyframe))
    return Found(after, info)


def relocalise(
    params: TrackerParams,
    tracker: Tracker,
    features: FrameFeatures,
    graph: KeyframeGraph,
    config: GraphConfig,
    *,
    seconds: float,
) -> tuple[Localised | None, Suspicion]:
    """Look for a frame in the keyframes whose images look most like it.

    A place that the camera can have reached since its last pose is believed at once. Two rooms may look the
    same, so elsewhere two keyframes have to agree, and none may contradict them. Frames before must have been
    found there too.

    Args:
        params: parameters of tracking.
        tracker: after the frame was lost.
        features: of the frame.
        graph: keyframes to look in, at least one.
        config: settings.
        seconds: since the frame before; 0 if unknown.

    Returns:
        Where it was found, and where it may be if later frames confirm that.
    """
    if not np.asarray(features.keypoints.features.valid).any():
        return None, NO_SUSPICION
    signature = np.asarray(features.keypoints.signature)
    alike, _ = most_similar(graph.signatures, signature, config.relocalisation_candidates)
    last = np.asarray(tracker.T_world_cam.wxyz_xyz) if tracker.keyframe_on_host >= 0 else None
    # Many matches and much alike images stand for a guess.
    allowed = allowed_sources(tracker, params.config)._replace(near_guess=np.asarray(True))
    since = float(tracker.since_tracked)
    found: list[Localised] = []
    poses: list[Float[np.ndarray, "7"]] = []
    T = se3.matrices_of(graph.poses)
    for number in map(int, alike):
        target = as_reference(params, graph, number)
        registration = register(params, features, target.features, se3.identity(), allowed, guess_known=False)
        if not supports_relocalisation(registration, config):
            continue
        found.append(Localised(target, registration, bridged=False, relocalised=True))
        T_keyframe_cam = se3.matrices_of(np.asarray(registration.T_target_source.wxyz_xyz)[None])[0]
        poses.append(se3.parameters_of((T[number] @ T_keyframe_cam)[None])[0])
        if last is not None and is_reachable(poses[-1], last, since, config):
            return found[-1], NO_SUSPICION
    places = [(pose, place.registration) for pose, place in zip(poses, found, strict=True)]
    best = undisputed(places, params.config.max_disagreement)
    if best is None:
        return None, NO_SUSPICION
    suspicion = strengthened(tracker.suspicion, poses[best], seconds, config)
    return (found[best] if int(suspicion.frames) >= config.relocalisation_frames else None), suspicion


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
    target = last_as_reference(params, tracker) if bridged else reference_at(tracker, tracker.current)
    # It is not near any of these guesses, but in reach of them.
    allowed = allowed._replace(near_guess=np.asarray(False))
    for turn in config.search_angle * _TURNS:
        start = se3.exp(turn) if bridged else se3.compose(tracker.T_reference_cam, se3.exp(turn))
        found = register(params, features, target.features, start, allowed)
        # Nothing confirms the guess where the surface leaves a direction free.
        if int(found.source) not in (PoseSource.LOST, PoseSource.MOTION_MODEL):
            return Localised(target, found, bridged, relocalised=False)
    return None


@jax.jit
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
    before, registration = tracker.T_world_cam, found.registration
    tracker = with_reference(tracker, found.reference)
    count = jnp.maximum(tracker.num_keyframes, found.reference.keyframe + 1)
    tracker = eqx.tree_at(lambda t: t.num_keyframes, tracker, count)
    tracker, info = settle(
        params,
        tracker,
        features,
        registration,
        before=before,
        source=registration.source,
        relocalised=found.relocalised,
    )
    return tracker, eqx.tree_at(lambda i: i.bridged, info, jnp.asarray(found.bridged))
