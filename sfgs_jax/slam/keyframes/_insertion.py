"""Insertion of keyframes: their place in the graph, and the registrations they wait for."""

from dataclasses import replace
from typing import NamedTuple

import jaxlie
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.arrays import appended
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import Found, depth_parameters_in_use, estimated_timing
from sfgs_jax.slam.keyframes._covariances import motion_covariance
from sfgs_jax.slam.keyframes._depth_drift import drift_of_followers
from sfgs_jax.slam.keyframes._edges import edge_of
from sfgs_jax.slam.keyframes._landmarks import share_landmarks
from sfgs_jax.slam.keyframes._loops import loop_pairs
from sfgs_jax.slam.keyframes._rectification_anew import rectified_anew, with_first_motion, with_motion_to_next
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph, TrackedPair
from sfgs_jax.slam.state._maps import maps_of
from sfgs_jax.slam.state._registration import Registration
from sfgs_jax.slam.state._tracker import Tracker, TrackerParams, reference_at


def with_new_keyframes(
    params: TrackerParams,
    graph: KeyframeGraph,
    before: Tracker,
    found: Found,
    frames: tuple[int, int],
    config: GraphConfig,
) -> KeyframeGraph:
    """The graph with the keyframes that tracking took: the frame before as a bridge, and the frame itself.

    Args:
        params: parameters of tracking.
        graph: before.
        before: tracker before the frame.
        found: the tracker after it, whose references are the features of the new keyframes, and what happened
            to the frame.
        frames: numbers of the newest tracked frame before it, and of the frame itself.
        config: settings.
    """
    after, info = found.tracker, found.info
    taken, bridged = bool(info.new_keyframe), bool(info.bridged)
    if found.begins_map or not graph.keyframes:
        return first_keyframe(params, graph, _from_ring(after, 0, frames[1]), info.T_world_cam, config)
    if graph.keyframes[-1].frame == frames[0]:
        graph = with_first_motion(graph, np.asarray(after.last_motion.twist))
        graph = _in_its_motion(params, graph, after)
    if bridged:
        reference = before.keyframe_on_host
        # The frame's own keyframe came after it.
        new = _from_ring(after, int(taken), frames[0])
        graph = insert_keyframe(params, graph, new, before.last_registration, reference, config)
        graph = _in_its_motion(params, graph, after)
    if taken:
        new, reference = _from_ring(after, 0, frames[1]), int(info.reference)
        graph = insert_keyframe(params, graph, new, info.registration, reference, config)
    if (taken or bridged) and params.config.estimate_timing:
        _, covariance = estimated_timing(params, after)
        graph = replace(graph, times_covariance=np.asarray(covariance, np.float64))
        if bool(after.last_motion.known):
            graph = rectified_anew(params, graph, after.last_motion.timing.on_host(), config)
    return graph


def _in_its_motion(params: TrackerParams, graph: KeyframeGraph, after: Tracker) -> KeyframeGraph:
    """The graph whose newest keyframe is the frame before, now that its motion to this frame is known."""
    motion = after.last_motion
    if not params.config.estimate_timing or not bool(motion.known):
        return graph
    return with_motion_to_next(params, graph, np.asarray(motion.twist), float(after.motion_seconds))


class NewKeyframe(NamedTuple):
    """A frame that becomes a keyframe.

    Attributes:
        features: of the frame, rectified.
        twist: its motion per second while it was read; zeros if unknown.
        times: of the rows, by which the features were rectified.
        frame: its number in its source.
    """

    features: FrameFeatures
    twist: Float[np.ndarray, "6"]
    times: Float[np.ndarray, "3"]
    frame: int


def _from_ring(tracker: Tracker, back: int, frame: int) -> NewKeyframe:
    """The tracker's current reference, or one that it had before, as a keyframe."""
    slot = (np.asarray(tracker.current) - back) % len(tracker.reference_keyframes)
    features, motion, *_ = reference_at(tracker, slot.astype(np.int32))
    return NewKeyframe(features, np.asarray(motion.twist), motion.timing.on_host(), frame)


def first_keyframe(
    params: TrackerParams,
    graph: KeyframeGraph,
    new: NewKeyframe,
    T_world_cam: jaxlie.SE3,
    config: GraphConfig,
) -> KeyframeGraph:
    """The graph with the first keyframe of a map, waiting to be tied to those of other maps.

    Args:
        params: parameters of tracking.
        graph: before.
        new: the frame.
        T_world_cam: where the map begins; the identity for the first map, whose camera is the world frame.
        config: settings.
    """
    identity, pose = np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32), np.asarray(T_world_cam.wxyz_xyz)
    number = len(graph.keyframes)
    graph = _with_keyframe(params, graph, new, pose, identity, np.zeros((1, 6, 6)), reference=number)
    return replace(graph, pending=(*graph.pending, *loop_pairs(graph, config))) if config.enabled else graph


def insert_keyframe(
    params: TrackerParams,
    graph: KeyframeGraph,
    new: NewKeyframe,
    found: Registration,
    reference: int,
    config: GraphConfig,
) -> KeyframeGraph:
    """The graph with a frame as a keyframe, tied to its reference and waiting to be tied to others.

    The equations of the camera by that registration wait too: they take longer than the rest of it.

    Args:
        params: parameters of tracking.
        graph: before.
        new: the frame.
        found: its registration to the reference.
        reference: number of the keyframe that it was tracked in.
        config: settings.
    """
    motion = np.asarray(found.T_target_source.wxyz_xyz)
    pose = np.asarray(se3.compose(graph.pose(reference), found.T_target_source).wxyz_xyz)
    own = motion_covariance(found, graph.noise, params.config.motion_model_sigma)
    covariance = se3.composed_covariances(
        graph.covariances[reference][None], se3.matrices_of(motion[None]), own[None]
    )
    source = len(graph.keyframes)
    graph = _with_keyframe(params, graph, new, pose, motion, covariance, reference=reference)
    if not config.enabled:
        return graph
    graph = share_landmarks(graph, reference, source, found)
    edge = edge_of(reference, source, found, config, depth_parameters_in_use(params))
    graph = replace(graph, edges=(*graph.edges, edge))
    near = neighbours(graph, config)
    far = tuple(pair for pair in loop_pairs(graph, config) if pair not in near and pair[0] != reference)
    return replace(
        graph,
        tracked=(*graph.tracked, TrackedPair(reference, source, found)),
        pending=(*graph.pending, *near, *far),
    )


def _with_keyframe(
    params: TrackerParams,
    graph: KeyframeGraph,
    new: NewKeyframe,
    pose: np.ndarray,
    tracked: np.ndarray,
    covariance: Float[np.ndarray, "1 6 6"],
    *,
    reference: int,
) -> KeyframeGraph:
    slots = new.features.keypoints.depth.shape[0]
    keyframe = Keyframe(
        features=new.features,
        landmarks=np.full(slots, -1),
        frame=new.frame,
        reference=reference,
        T_reference_keyframe=tracked,
        depth_parameters=depth_parameters_in_use(params),
        twist=new.twist,
        times=new.times,
        edition=0,
    )
    moved = np.zeros((1, *graph.depth_sensitivities.shape[1:]))
    if reference < len(graph.keyframes):
        moved = drift_of_followers(graph.depth_sensitivities[reference], se3.matrices_of(tracked[None]))
    return replace(
        graph,
        keyframes=(*graph.keyframes, keyframe),
        poses=np.concatenate([graph.poses, pose[None]]),
        covariances=np.concatenate([graph.covariances, covariance]),
        depth_sensitivities=appended(graph.depth_sensitivities, moved),
        signatures=appended(graph.signatures, np.asarray(new.features.keypoints.signature)[None]),
    )


def neighbours(graph: KeyframeGraph, config: GraphConfig) -> tuple[tuple[int, int], ...]:
    """Pairs (target, source) of the newest keyframe with earlier ones that see the same.

    Judged by the poses: cameras near each other that look the same way, except those it has an edge to.
    Without loops only recent keyframes count: one from before would close a loop, however small the drift.

    Args:
        graph: with at least one keyframe.
        config: settings.
    """
    poses = se3.matrices_of(graph.poses)
    newest = len(poses) - 1
    known = {edge.target for edge in graph.edges if edge.source == newest}
    maps = maps_of(graph)
    near, apart = seen_from(poses[:newest], poses[newest], config)
    near &= maps[:newest] == maps[newest]
    if not config.loops:
        near &= newest - np.arange(newest) <= config.loop_gap
    order = np.argsort(apart, kind="stable")
    chosen = [int(i) for i in order if near[i] and int(i) not in known][: config.num_neighbours]
    return tuple((i, newest) for i in chosen)


def seen_from(
    poses: Float[np.ndarray, "n 4 4"], pose: Float[np.ndarray, "4 4"], config: GraphConfig
) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Which cameras are near another and look the same way, and how far apart they are, metres plus radians.

    Args:
        poses: `T_world_cam` of n cameras.
        pose: of the other one.
        config: settings.
    """
    distance = np.linalg.norm(poses[:, :3, 3] - pose[:3, 3], axis=1)
    angle = np.arccos(np.clip(poses[:, :3, 2] @ pose[:3, 2], -1, 1))
    near = (distance < config.neighbour_distance) & (angle < config.neighbour_angle)
    return near, distance + angle
