"""Keyframes after the estimate of the times of the rows has changed: rectified and registered anew.

The first keyframes are taken before the times are known. If the camera turns, their rows are off by more than
all later registrations err.
"""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera
from sfgs_jax.gicp import RowMotion
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import rectified
from sfgs_jax.slam.keyframes._edge_noise import prior_noise
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_SOON = 3.0
"""Motion of the rows, in deviations of an edge, for which a keyframe is not left until the end of the run."""


def with_first_motion(graph: KeyframeGraph, moving: RowMotion) -> KeyframeGraph:
    """The graph whose newest keyframe moved like the frame after it, if its own motion is unknown.

    It was taken for a camera at rest, so that no times of rows are used in it yet.

    Args:
        graph: with a keyframe.
        moving: motion of the rows of the next frame.
    """
    newest = graph.keyframes[-1]
    if bool(newest.motion.known) or not bool(moving.known):
        return graph
    still = SensorTiming(*np.zeros(3, np.float32))
    newest = replace(newest, motion=replace(moving, timing=still))
    return replace(graph, keyframes=(*graph.keyframes[:-1], newest))


def rectified_anew(
    params: TrackerParams,
    graph: KeyframeGraph,
    timing: SensorTiming,
    config: GraphConfig,
    *,
    deviations: float = _SOON,
) -> KeyframeGraph:
    """The graph with its keyframes rectified by the times as they are known now.

    They are registered anew too. Until then their edges hold.

    Args:
        params: parameters of tracking.
        graph: before.
        timing: times of the rows as the newest frame was tracked with.
        config: settings.
        deviations: motion of the outermost rows from which on that is worth it, in the deviations of an edge
            that the settings have.
    """
    times = np.asarray(timing.vector)
    errors = prior_noise(config).covariance
    stale = [i for i, k in enumerate(graph.keyframes) if _surprise(k, times, errors) > deviations**2]
    if not stale:
        return graph
    keyframes = list(graph.keyframes)
    for number in stale:
        keyframe = keyframes[number]
        keyframes[number] = replace(
            keyframe,
            features=_moved(keyframe.features, params.camera, keyframe.motion, timing),
            motion=replace(keyframe.motion, timing=timing),
            edition=keyframe.edition + 1,
        )
    again = [
        (edge.target, edge.source)
        for edge in graph.edges
        if not edge.loop and (edge.target in stale or edge.source in stale)
    ]
    waiting = [pair for pair in graph.pending if pair not in again]
    return replace(graph, keyframes=tuple(keyframes), pending=(*again, *waiting))


def _surprise(
    keyframe: Keyframe, times: Float[np.ndarray, "3"], covariance: Float[np.ndarray, "6 6"]
) -> float:
    """Squared motion of the outermost rows by the change of the times, in deviations of an edge."""
    if not bool(keyframe.motion.known):
        return 0.0
    delay, colour, depth = np.abs(times - np.asarray(keyframe.motion.timing.vector))
    moved = max(colour / 2, delay + depth / 2) * np.asarray(keyframe.motion.twist, float)
    return float(moved @ np.linalg.solve(covariance, moved))


@jax.jit
def _moved(features: FrameFeatures, camera: Camera, before: RowMotion, timing: SensorTiming) -> FrameFeatures:
    change = SensorTiming.of_vector(timing.vector - before.timing.vector)
    return rectified(features, camera, RowMotion(before.twist, change, before.known))
