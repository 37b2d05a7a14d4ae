"""Adjustments that run while the next frames are tracked, and what becomes of the graph meanwhile."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sfgs_jax.factor_graph import Status
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._adjustment import adjust, window_of
from sfgs_jax.slam.keyframes._covariances import covariances_in_world
from sfgs_jax.slam.keyframes._landmarks import with_positions
from sfgs_jax.slam.keyframes._pose_graph import bend
from sfgs_jax.slam.state._keyframe_graph import Adjustment, Keyframe, KeyframeGraph, PendingAdjustment
from sfgs_jax.slam.state._tracker import TrackerParams

_aside = ThreadPoolExecutor(1)
"""A thread for adjustments, so that tracking waits neither for their solvers nor for their set-up. A graph is
never changed, only replaced: the thread has its own as it was."""


def with_adjustment_begun(
    params: TrackerParams,
    graph: KeyframeGraph,
    config: GraphConfig,
    *,
    around: int | None = None,
    bent: bool = False,
) -> KeyframeGraph:
    """The graph with an adjustment started; it does not wait for the results.

    To bend all keyframes takes longer, the more of them there are. For every two windows of them it gets the
    time of one window's adjustment.

    Args:
        params: parameters of tracking.
        graph: without an adjustment.
        config: settings.
        around: number of the keyframe in the middle of the window, the newest if not given.
        bent: whether the graph is bent by its new edges first.
    """
    if len(graph.keyframes) < 2:
        return graph
    results = _aside.submit(_adjusted, params, graph, config, around, bent)
    times = 1 + (len(graph.keyframes) // (2 * config.window) if bent else 0)
    return replace(graph, adjustment=PendingAdjustment(results, times * config.adjustment_frames))


def _adjusted(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, around: int | None, bent: bool
) -> Adjustment:
    """The adjustment of a graph, whose keyframes after the window's newest move with their references."""
    if bent:
        graph = bend(graph, config)
    window = window_of(params, graph, config, around=around)
    found = adjust(params, window)
    if int(found.solution.status) == Status.DIVERGED:
        none = np.zeros(0, int)
        return Adjustment(graph.poses, none, 0, np.zeros((0, 6, 6)), none, np.zeros((0, 3), np.float32))
    members, landmarks = (
        np.asarray(numbers)[np.asarray(numbers) >= 0] for numbers in (window.members, window.landmarks)
    )
    poses = graph.poses.copy()
    poses[members] = np.asarray(found.solution.values.poses.wxyz_xyz)[: len(members)]
    first = int(members.max()) + 1
    return Adjustment(
        poses=_with_later_ones(graph.keyframes, graph.poses, poses[:first]),
        members=members,
        anchor=int(window.anchor),
        covariances=np.asarray(found.covariances, np.float64)[: len(members)],
        landmarks=landmarks,
        points=np.asarray(found.solution.values.landmarks)[: len(landmarks)],
    )


def with_frame_passed(graph: KeyframeGraph) -> KeyframeGraph:
    """The graph one frame later; it takes the results of an adjustment whose time has come.

    Args:
        graph: before.
    """
    if graph.adjustment is None:
        return graph
    if graph.adjustment.frames_left < 1:
        return with_adjustment_taken(graph)
    left = graph.adjustment.frames_left - 1
    return replace(graph, adjustment=replace(graph.adjustment, frames_left=left))


def with_adjustment_taken(graph: KeyframeGraph) -> KeyframeGraph:
    """The graph with the results of its adjustment, if it has one; it waits for them.

    Keyframes that came since it was started move with those that they were tracked in.

    Args:
        graph: before.
    """
    if graph.adjustment is None:
        return graph
    found = graph.adjustment.wait()
    poses = _with_later_ones(graph.keyframes, graph.poses, found.poses)
    covariances, members = graph.covariances.copy(), found.members
    if len(members):
        covariances[members] = covariances_in_world(
            found.covariances, poses[members], graph.covariances[members], found.anchor
        )
    return with_positions(
        replace(graph, adjustment=None, poses=poses, covariances=covariances), found.landmarks, found.points
    )


def _with_later_ones(
    keyframes: Sequence[Keyframe], before: Float[np.ndarray, "n 7"], moved: Float[np.ndarray, "m 7"]
) -> Float[np.ndarray, "n 7"]:
    """Poses of keyframes of which the first m have been moved; the others move with their references."""
    first = len(moved)
    poses = np.concatenate([moved, before[first:]])
    # A reference may itself have come later, and moved with its own. The first keyframe of a map has none.
    moves_with = np.arange(len(before))
    for number in range(first, len(before)):
        moves_with[number] = moves_with[keyframes[number].reference]
    moves_with = moves_with[first:]
    now, at, later = map(se3.matrices_of, (poses[moves_with], before[moves_with], before[first:]))
    poses[first:] = se3.parameters_of(now @ np.linalg.inv(at) @ later)
    return poses
