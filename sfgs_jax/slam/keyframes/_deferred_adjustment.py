"""Adjustments that run while the next frames are tracked, and what becomes of the graph meanwhile."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from sfgs_jax.factor_graph import Status
from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._adjustment import adjust, window_of
from sfgs_jax.slam.keyframes._covariances import covariances_in_world
from sfgs_jax.slam.keyframes._landmarks import with_positions
from sfgs_jax.slam.state._keyframe_graph import Adjustment, KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_aside = ThreadPoolExecutor(1)
"""A thread to start adjustments from. JAX runs the calls of one thread in order, so that the next frame would
wait for an adjustment; calls of two threads run side by side."""


def with_adjustment_begun(
    params: TrackerParams, graph: KeyframeGraph, config: GraphConfig, *, around: int | None = None
) -> KeyframeGraph:
    """The graph with an adjustment started; it does not wait for the results.

    Args:
        params: parameters of tracking.
        graph: without an adjustment.
        config: settings.
        around: number of the keyframe in the middle of the window, the newest if not given.
    """
    if len(graph.keyframes) < 2:
        return graph
    window = window_of(params, graph, config, around=around)
    found = _aside.submit(adjust, params, window).result()
    begun = Adjustment(
        members=np.asarray(window.members),
        anchor=int(window.anchor),
        landmarks=np.asarray(window.landmarks),
        poses=found.solution.values.poses.wxyz_xyz,
        covariances=found.covariances,
        points=found.solution.values.landmarks,
        status=found.solution.status_code,
        frames_left=config.adjustment_frames,
    )
    return replace(graph, adjustment=begun)


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
    found = graph.adjustment
    if found is None:
        return graph
    graph = replace(graph, adjustment=None)
    if int(found.status) == Status.DIVERGED:
        return graph
    members = found.members[found.members >= 0]
    poses, covariances = graph.poses.copy(), graph.covariances.copy()
    poses[members] = np.asarray(found.poses)[: len(members)]
    covariances[members] = covariances_in_world(
        np.asarray(found.covariances, np.float64)[: len(members)],
        poses[members],
        graph.covariances[members],
        found.anchor,
    )
    for number in range(int(members.max()) + 1, len(poses)):
        reference = graph.keyframes[number].reference
        before, after, moving = se3.matrices_of(
            np.stack([graph.poses[reference], poses[reference], graph.poses[number]])
        )
        poses[number] = se3.parameters_of((after @ np.linalg.inv(before) @ moving)[None])[0]
    numbers = found.landmarks[found.landmarks >= 0]
    return with_positions(
        replace(graph, poses=poses, covariances=covariances),
        numbers,
        np.asarray(found.points)[: len(numbers)],
    )
