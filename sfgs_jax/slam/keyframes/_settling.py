"""The adjustments at the end of a run: windows over all keyframes, each until it changes little."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float, Int

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._adjustment import has_landmarks
from sfgs_jax.slam.keyframes._deferred_adjustment import with_adjustment_begun, with_adjustment_taken
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._tracker import TrackerParams

_MOST_ADJUSTMENTS = 10
"""Of a window."""
_STILL = 2e-4
"""Change of a motion between keyframes below which it counts as still, metres or of its rotation matrix."""


def settled(params: TrackerParams, graph: KeyframeGraph, config: GraphConfig) -> KeyframeGraph:
    """The graph adjusted until that changes little.

    A window is adjusted again only where its keyframes have moved against each other. Its own adjustment
    moves them, and that of a window that overlaps.

    Args:
        params: parameters of tracking.
        graph: before.
        config: settings.
    """
    if not config.enabled or not has_landmarks(params, config):
        return graph
    graph = with_adjustment_taken(graph)
    starts: dict[int, tuple[Int[np.ndarray, " w"], Float[np.ndarray, "w 4 4"]]] = {}
    for _ in range(_MOST_ADJUSTMENTS):
        moved = False
        for centre in _centres(len(graph.keyframes), config.window):
            if centre in starts and _are_still(graph, *starts[centre]):
                continue
            before = graph
            graph = with_adjustment_begun(params, graph, config, around=centre)
            members = graph.adjustment.wait().members if graph.adjustment is not None else np.zeros(0, int)
            graph, starts[centre] = with_adjustment_taken(graph), (members, _motions(before, members))
            moved = True
        if not moved:
            break
    return graph


def _centres(count: int, window: int) -> Iterable[int]:
    """Middles of windows that overlap by half and reach all keyframes, the newest last."""
    if count <= window:
        return (count - 1,)
    return reversed(range(count - 1, 0, -max(1, window // 2)))


def _are_still(
    graph: KeyframeGraph, members: Int[np.ndarray, " w"], start: Float[np.ndarray, "w 4 4"]
) -> bool:
    """Whether a window's keyframes are to each other as before its last adjustment."""
    return bool(np.abs(_motions(graph, members) - start).max(initial=0) < _STILL)


def _motions(graph: KeyframeGraph, members: Int[np.ndarray, " w"]) -> Float[np.ndarray, "w 4 4"]:
    """`T_first_keyframe` of a window's keyframes, with the first of them."""
    T = se3.matrices_of(graph.poses[members])
    return np.linalg.inv(T[:1]) @ T
