"""Maps of a run: the parts of its keyframe graph that nothing ties to each other.

A camera that is lost in a place that nobody knows begins another map. Maps become one when a place of both is
recognised. Source: the atlas of ORB-SLAM3 (Campos et al., 2021), section VI.
"""

import numpy as np
from jaxtyping import Bool, Int
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph

_SPACING = 100.0
"""Distance between the origins of maps that nothing ties to each other, metres. It is larger than a room, and
float32 still keeps hundredths of a millimetre there."""


def next_origin(graph: KeyframeGraph) -> float:
    """Place on the x axis where another map begins, apart from those of a graph; metres.

    Args:
        graph: with at least one keyframe.
    """
    return float(_SPACING * (1 + np.floor(graph.poses[:, 4].max() / _SPACING)))


def maps_of(graph: KeyframeGraph) -> Int[np.ndarray, " n"]:
    """The map of each keyframe, named by the number of its first keyframe.

    Args:
        graph: with n keyframes.
    """
    count = len(graph.keyframes)
    tied = [(number, keyframe.reference) for number, keyframe in enumerate(graph.keyframes)]
    if sum(number == reference for number, reference in tied) < 2:
        return np.zeros(count, int)  # most runs, of any length
    tied += [(edge.target, edge.source) for edge in graph.edges]
    a, b = np.asarray(tied, int).reshape(-1, 2).T
    ties = coo_array((np.ones(len(a)), (a, b)), shape=(count, count))
    _, labels = connected_components(ties, directed=False)
    return np.unique(labels, return_index=True)[1][labels]


def first_keyframes(graph: KeyframeGraph) -> Bool[np.ndarray, " n"]:
    """Which keyframes are the first of their map; these stay where they are when the others move.

    Args:
        graph: with n keyframes.
    """
    return maps_of(graph) == np.arange(len(graph.keyframes))


def frames_by_map(log: FrameLog, graph: KeyframeGraph) -> list[tuple[int, Int[np.ndarray, " k"]]]:
    """The first keyframe of each map, and the rows of its k frames in the log; the map of most frames first.

    Args:
        log: of the tracked frames.
        graph: with their keyframes.
    """
    maps = maps_of(graph)[log.keyframes]
    rows = [(int(first), np.flatnonzero(maps == first)) for first in np.unique(maps)]
    return sorted(rows, key=lambda found: -len(found[1]))
