"""Two graphs as one: the second is another map of the first, until a place of both is recognised."""

from dataclasses import replace

import numpy as np

from sfgs_jax.geometry import se3
from sfgs_jax.slam.config import GraphConfig
from sfgs_jax.slam.keyframes._insertion import seen_from
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph, Landmarks, TrackedPair
from sfgs_jax.slam.state._maps import maps_of, next_origin

Pairs = tuple[tuple[int, int], ...]
"""Numbers of keyframes that wait for their registration: target and source."""


def joined_graphs(graph: KeyframeGraph, other: KeyframeGraph, shift: int) -> KeyframeGraph:
    """The keyframes of two graphs, those of the other one after, in maps of their own.

    Loops that nothing has confirmed by the end of a recording are given up.

    Args:
        graph: of the first recording, no adjustment under way.
        other: of the second recording, likewise.
        shift: added to the numbers of its frames.
    """
    first, placed = len(graph.keyframes), len(graph.landmarks)
    poses = other.poses.copy()
    poses[:, 4] += next_origin(graph)
    after = tuple(_renumbered(keyframe, first, placed, shift) for keyframe in other.keyframes)
    edges = tuple(replace(e, target=e.target + first, source=e.source + first) for e in other.edges)
    tracked = (TrackedPair(p.target + first, p.source + first, p.found) for p in other.tracked)
    # The edges that the poses hold already come first.
    absorbed = (*graph.edges[: graph.num_absorbed], *edges[: other.num_absorbed])
    new = (*graph.edges[graph.num_absorbed :], *edges[other.num_absorbed :])
    moved = np.where(other.landmarks.keyframes < 0, -1, other.landmarks.keyframes + first)
    return replace(
        graph,
        keyframes=(*graph.keyframes, *after),
        poses=np.concatenate([graph.poses, poses]),
        covariances=np.concatenate([graph.covariances, other.covariances]),
        depth_sensitivities=np.concatenate([graph.depth_sensitivities, other.depth_sensitivities]),
        signatures=np.concatenate([graph.signatures, other.signatures]),
        edges=absorbed + new,
        num_absorbed=len(absorbed),
        tracked=(*graph.tracked, *tracked),
        pending=(*graph.pending, *((a + first, b + first) for a, b in other.pending)),
        again=(*graph.again, *((a + first, b + first) for a, b in other.again)),
        candidates=(),
        landmarks=Landmarks(
            np.concatenate([graph.landmarks.keyframes, moved]),
            np.concatenate([graph.landmarks.points, other.landmarks.points]),
        ),
        depth=graph.depth.joined(other.depth),
        focal=graph.focal.joined(other.focal),
    )


def _renumbered(keyframe: Keyframe, first: int, placed: int, shift: int) -> Keyframe:
    return replace(
        keyframe,
        landmarks=np.where(keyframe.landmarks < 0, -1, keyframe.landmarks + placed),
        frame=keyframe.frame + shift,
        reference=keyframe.reference + first,
    )


def pairs_that_look_alike(graph: KeyframeGraph, first: int, config: GraphConfig, *, most: int) -> Pairs:
    """Pairs of keyframes of two recordings whose images look alike, the most similar first.

    Args:
        graph: with the keyframes of both.
        first: number of the first keyframe of the second recording.
        config: settings.
        most: pairs for each keyframe of the second recording.
    """
    alike = graph.signatures[first:] @ graph.signatures[:first].T
    best = np.argsort(-alike, axis=1, kind="stable")[:, :most]
    similarity = np.take_along_axis(alike, best, axis=1)
    rows, columns = np.nonzero(similarity > config.loop_similarity)
    order = np.argsort(-similarity[rows, columns], kind="stable")
    return tuple((int(best[r, c]), first + int(r)) for r, c in zip(rows[order], columns[order], strict=True))


def pairs_that_see_the_same(graph: KeyframeGraph, first: int, config: GraphConfig) -> Pairs:
    """Pairs of keyframes of two recordings that are near each other and have no edge, the nearest first.

    Args:
        graph: with the keyframes of both, where they are now.
        first: number of the first keyframe of the second recording.
        config: settings of neighbours.
    """
    T, maps = se3.matrices_of(graph.poses), maps_of(graph)
    known = {(edge.target, edge.source) for edge in graph.edges}
    found: list[tuple[float, tuple[int, int]]] = []
    for source in range(first, len(graph.keyframes)):
        near, apart = seen_from(T[:first], T[source], config)
        near &= maps[:first] == maps[source]
        order = [int(i) for i in np.argsort(apart, kind="stable") if near[i]]
        chosen = [i for i in order if (i, source) not in known][: config.num_neighbours]
        found += [(float(apart[i]), (i, source)) for i in chosen]
    return tuple(pair for _, pair in sorted(found))


def tied(graph: KeyframeGraph, first: int) -> bool:
    """Whether a map has keyframes of both recordings.

    Args:
        graph: with the keyframes of both.
        first: number of the first keyframe of the second recording.
    """
    maps = maps_of(graph)
    return not set(maps[:first].tolist()).isdisjoint(maps[first:].tolist())
