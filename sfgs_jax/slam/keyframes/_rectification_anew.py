"""Keyframes after the estimate of the times of the rows has changed: rectified and registered anew.

The first keyframes are taken before the times are known. If the camera turns, their rows are off by more than
all later registrations err.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.geometry import Camera
from sfgs_jax.gicp import RowMotion
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.frontend import rectified
from sfgs_jax.slam.keyframes._edges import prior_noise
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_ROWS_KNOWN = 2.0
"""Motion of the rows that may be unknown, in deviations of an edge, where a pair tells about depth."""
_SOON = 3.0
"""Motion of the rows, in deviations of an edge, for which a keyframe is not left until the end of the run."""


def with_first_motion(graph: KeyframeGraph, twist: Float[np.ndarray, "6"]) -> KeyframeGraph:
    """The graph whose newest keyframe moved like the frame after it, if its own motion is unknown.

    It was taken for a camera at rest, so that no times of rows are used in it yet.

    Args:
        graph: with a keyframe.
        twist: motion of the next frame per second.
    """
    newest = graph.keyframes[-1]
    if newest.twist.any():
        return graph
    newest = replace(newest, twist=twist, times=np.zeros(3, np.float32))
    return replace(graph, keyframes=(*graph.keyframes[:-1], newest))


def with_motion_to_next(
    params: TrackerParams, graph: KeyframeGraph, twist: Float[np.ndarray, "6"], seconds: float
) -> KeyframeGraph:
    """The graph whose newest keyframe is rectified by the motion that it had halfway from colour to depth.

    When it was tracked, only the motion from the frame before it was known: its mean, half a frame ago. The
    motion to the next frame tells how it changed.

    Args:
        params: parameters of tracking.
        graph: with a keyframe, which the newest frame follows.
        twist: motion per second from the keyframe to the frame after it.
        seconds: between these two; the frame before counts as equally far.
    """
    newest = graph.keyframes[-1]
    if not (newest.twist.any() and newest.times.any()):
        return graph
    share = float(np.clip((1 + newest.times[0] / seconds) / 2, 0, 1))
    change = share * (twist - newest.twist)
    newest = _rectified(newest, params.camera, change, newest.times)
    newest = replace(newest, twist=newest.twist + change)
    return replace(graph, keyframes=(*graph.keyframes[:-1], newest))


def with_pairs_of_known_motion(params: TrackerParams, graph: KeyframeGraph, newest: int) -> KeyframeGraph:
    """The graph as registrations see it: those of a keyframe wait for its motion to the next frame.

    Args:
        params: parameters of tracking.
        graph: before the next frame.
        newest: number of the newest frame.
    """
    if not params.config.estimate_timing or not graph.keyframes or graph.keyframes[-1].frame != newest:
        return graph
    last = len(graph.keyframes) - 1
    return replace(
        graph,
        tracked=tuple(pair for pair in graph.tracked if last not in (pair.target, pair.source)),
        pending=tuple(pair for pair in graph.pending if last not in pair),
    )


def rectified_anew(
    params: TrackerParams,
    graph: KeyframeGraph,
    times: Float[np.ndarray, "3"],
    config: GraphConfig,
    *,
    deviations: float = _SOON,
) -> KeyframeGraph:
    """The graph with its keyframes rectified by the times as they are known now.

    They are registered anew too, after all new pairs. Until then their edges hold.

    Args:
        params: parameters of tracking.
        graph: before.
        times: of the rows, as the newest frame was tracked with.
        config: settings.
        deviations: motion of the outermost rows from which on that is worth it, in the deviations of an edge
            that the settings have.
    """
    stale = np.flatnonzero(_surprises(graph, times, config) > deviations**2).tolist()
    if not stale:
        return graph
    keyframes = list(graph.keyframes)
    for number in stale:
        keyframe = keyframes[number]
        moved = _rectified(keyframe, params.camera, keyframe.twist, times - keyframe.times)
        keyframes[number] = replace(moved, times=times)
    again = [
        (edge.target, edge.source)
        for edge in graph.edges
        if not edge.loop and (edge.target in stale or edge.source in stale)
    ]
    waiting = tuple(pair for pair in graph.again if pair not in again)
    tracked = tuple(pair for pair in graph.tracked if (pair.target, pair.source) not in again)
    return replace(graph, keyframes=tuple(keyframes), tracked=tracked, again=(*waiting, *again))


def _surprises(
    graph: KeyframeGraph, times: Float[np.ndarray, "3"], config: GraphConfig
) -> Float[np.ndarray, " n"]:
    """Squared motions of the outermost rows by the change of the times, in deviations of an edge."""
    known = np.stack([keyframe.times for keyframe in graph.keyframes])
    return _row_motions(graph.keyframes, np.abs(times - known), config)


def rows_known(graph: KeyframeGraph, numbers: Sequence[int], config: GraphConfig) -> bool:
    """True if the rows of some keyframes lie where they belong, as far as the times are known.

    Args:
        graph: that holds them.
        numbers: of the keyframes.
        config: settings.
    """
    keyframes = [graph.keyframes[number] for number in numbers]
    off = np.abs(graph.keyframes[-1].times - np.stack([keyframe.times for keyframe in keyframes]))
    unknown = off + np.sqrt(np.diag(graph.times_covariance))
    return bool((_row_motions(keyframes, unknown, config) < _ROWS_KNOWN**2).all())


def _row_motions(
    keyframes: Sequence[Keyframe], off: Float[np.ndarray, "n 3"], config: GraphConfig
) -> Float[np.ndarray, " n"]:
    """Squared motions of the outermost rows in times that may add up, in deviations of an edge."""
    delay, colour, depth = off.T.astype(np.float64)
    moved = np.maximum(colour / 2, delay + depth / 2)[:, None] * np.stack([k.twist for k in keyframes])
    return np.einsum("ni,ij,nj->n", moved, np.linalg.inv(prior_noise(config).covariance), moved)


def _rectified(
    keyframe: Keyframe, camera: Camera, twist: Float[np.ndarray, "6"], times: Float[np.ndarray, "3"]
) -> Keyframe:
    """A keyframe whose rows are moved on by a motion in some times, as its next edition."""
    features = _moved(keyframe.features, camera, twist, times)
    return replace(keyframe, features=features, edition=keyframe.edition + 1)


@jax.jit
def _moved(
    features: FrameFeatures, camera: Camera, twist: Float[Array, "6"], change: Float[Array, "3"]
) -> FrameFeatures:
    moving = RowMotion(jnp.asarray(twist), SensorTiming.of_vector(jnp.asarray(change)), jnp.asarray(True))
    return rectified(features, camera, moving)
