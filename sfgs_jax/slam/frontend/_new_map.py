"""Start of another map, where a lost camera sees a place that no keyframe shows."""

from dataclasses import replace

import equinox as eqx
import jax
import jaxlie
import numpy as np

from sfgs_jax.geometry import Frame
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend._frame_features import host_keypoints
from sfgs_jax.slam.frontend._track import TrackInfo, track
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._maps import maps_of, next_origin
from sfgs_jax.slam.state._tracker import Suspicion, Tracker, TrackerParams, empty_tracker
from sfgs_jax.superfeats import mean_grey


def with_unknown_place(
    before: Suspicion, suspicion: Suspicion, features: FrameFeatures, config: GraphConfig
) -> Suspicion:
    """The suspicion after a frame that was found nowhere, which may be of a place that is not known.

    Args:
        before: suspicion before the frame.
        suspicion: after it was looked for.
        features: of the frame.
        config: settings.
    """
    if int(suspicion.frames):
        return replace(suspicion, unknown=np.asarray(0, np.int32))
    valid, depth = (np.asarray(x) for x in (features.keypoints.features.valid, features.keypoints.depth))
    # A dark frame, or one of a bare wall, would not be recognised in a known place either.
    recognisable = int((valid & (depth > 0)).sum()) >= config.relocalisation_inliers
    return replace(suspicion, unknown=np.asarray(int(before.unknown) + recognisable, np.int32))


def frames_until_new_map(tracker: Tracker, graph: KeyframeGraph, config: GraphConfig) -> int:
    """Frames that fit no known place after which a lost camera begins another map; 0 for never.

    A map of a few keyframes leaves little to come back to. The first frame may have been a bad one.

    Args:
        tracker: after the frame was lost.
        graph: with at least one keyframe.
        config: settings.
    """
    reference = tracker.keyframe_on_host
    if reference < 0:
        return config.new_map_frames
    maps = maps_of(graph)
    size = int((maps == maps[reference]).sum())
    return min(config.new_map_frames, config.relocalisation_frames * size)


def begin_map(
    params: TrackerParams, tracker: Tracker, frame: Frame, graph: KeyframeGraph
) -> tuple[Tracker, TrackInfo]:
    """The tracker that begins another map with a frame, and what happened to the frame.

    Until a place of both is recognised nobody knows where the maps lie to each other. They are kept apart.

    Args:
        params: parameters of tracking.
        tracker: after the frame was lost.
        frame: colour image and depth.
        graph: with the keyframes so far.
    """
    keypoints, elapsed = host_keypoints(params, frame), np.float32(0)
    start = without_pose(tracker)
    begun, info = track(params, start, mean_grey(frame.rgb), frame.depth, elapsed, keypoints)
    if not bool(info.new_keyframe):
        return tracker, info
    pose = np.asarray([1, 0, 0, 0, 0, 0, 0], graph.poses.dtype)
    pose[4] = next_origin(graph)
    number, slot = len(graph.keyframes), int(begun.current)
    poses, keyframes = np.array(begun.reference_poses), np.array(begun.reference_keyframes)
    poses[slot], keyframes[slot] = pose, number
    count = np.asarray(number + 1, np.int32)
    begun = eqx.tree_at(
        lambda t: (t.reference_poses, t.reference_keyframes, t.num_keyframes),
        begun,
        jax.device_put((poses, keyframes, count)),
    )
    return begun, eqx.tree_at(lambda i: i.T_world_cam, info, jaxlie.SE3(jax.device_put(pose)))


def without_pose(tracker: Tracker) -> Tracker:
    """The tracker without a pose and references; what it knows about the camera's sensors stays.

    Args:
        tracker: before.
    """
    slots = len(tracker.reference_keyframes)
    return empty_tracker(tracker.last, tracker.last_registration, tracker.timing, slots)
