"""Identity of landmarks: keypoints of several keyframes that show the same point."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._keyframe_graph import Keyframe, KeyframeGraph, Landmarks
from sfgs_jax.slam.state._registration import Registration


def share_landmarks(graph: KeyframeGraph, target: int, source: int, found: Registration) -> KeyframeGraph:
    """The graph in which the matched keypoints of two keyframes show the same landmarks.

    A keypoint that shows a landmark already hands it on; the others start one. A landmark lies where the
    first keyframe that measured its depth saw it, until an adjustment moves it.

    Args:
        graph: before.
        target: number of the keyframe registered to.
        source: number of the keyframe registered.
        found: the registration, with its matches.
    """
    # Lists and sets, not arrays: looking up single numbers takes a fraction of the time.
    a, b = (graph.keyframes[i].landmarks.tolist() for i in (target, source))
    in_a, in_b = set(a), set(b)
    slots_b = np.flatnonzero(np.asarray(found.matched.inliers))
    slots_a = np.asarray(found.matched.index)[slots_b]
    number = len(graph.landmarks)
    # A landmark has one place in an image.
    for slot_a, slot_b in zip(slots_a.tolist(), slots_b.tolist(), strict=True):
        if b[slot_b] >= 0:
            if a[slot_a] < 0 and b[slot_b] not in in_a:
                a[slot_a] = b[slot_b]
                in_a.add(a[slot_a])
            continue
        if a[slot_a] < 0:
            a[slot_a] = number
            in_a.add(number)
            number += 1
        if a[slot_a] not in in_b:
            b[slot_b] = a[slot_a]
            in_b.add(b[slot_b])
    keyframes = list(graph.keyframes)
    keyframes[target] = replace(keyframes[target], landmarks=np.asarray(a, int))
    keyframes[source] = replace(keyframes[source], landmarks=np.asarray(b, int))
    landmarks = _with_room(graph.landmarks, number)
    for place in (target, source):
        landmarks = _with_measured(landmarks, place, keyframes[place])
    return replace(graph, keyframes=tuple(keyframes), landmarks=landmarks)


def _with_room(landmarks: Landmarks, number: int) -> Landmarks:
    """The landmarks with others after them that have no place yet."""
    more = number - len(landmarks)
    return Landmarks(
        np.pad(landmarks.keyframes, (0, more), constant_values=-1),
        np.pad(landmarks.points, ((0, more), (0, 0))),
    )


def _with_measured(landmarks: Landmarks, number: int, keyframe: Keyframe) -> Landmarks:
    """The landmarks, those without a place where a keyframe measured them."""
    shown, keypoints = keyframe.landmarks, keyframe.features.keypoints
    new = np.flatnonzero((shown >= 0) & (np.asarray(keypoints.depth) > 0))
    new = new[landmarks.keyframes[shown[new]] < 0]
    keyframes, points = landmarks.keyframes.copy(), landmarks.points.copy()
    keyframes[shown[new]], points[shown[new]] = number, np.asarray(keypoints.points)[new]
    return Landmarks(keyframes, points)


def positions(graph: KeyframeGraph, numbers: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """World coordinates of some landmarks, metres; anything for one that has no place.

    Args:
        graph: that holds them.
        numbers: of the landmarks.
    """
    T = se3.matrices_of(graph.poses)[graph.landmarks.keyframes[numbers]]
    return np.einsum("nij,nj->ni", T[:, :3, :3], graph.landmarks.points[numbers]) + T[:, :3, 3]


def with_positions(
    graph: KeyframeGraph, numbers: Int[np.ndarray, " n"], found: Float[np.ndarray, "n 3"]
) -> KeyframeGraph:
    """The graph with some landmarks elsewhere.

    Args:
        graph: before, its keyframes where they are now.
        numbers: of landmarks that have a place.
        found: their world coordinates, metres.
    """
    T = se3.matrices_of(graph.poses)[graph.landmarks.keyframes[numbers]]
    points = graph.landmarks.points.copy()
    points[numbers] = np.einsum("nji,nj->ni", T[:, :3, :3], found - T[:, :3, 3])
    return replace(graph, landmarks=replace(graph.landmarks, points=points))


def chosen(
    keyframes: Int[np.ndarray, " n"], landmarks: Int[np.ndarray, " n"], capacity: int
) -> tuple[Int[np.ndarray, " l"], Int[np.ndarray, " n"]]:
    """Landmarks seen at least twice; where there are too many, those that most help some keyframe.

    Each keyframe puts its landmarks in order, the most often seen first, and a landmark has the best of its
    places. To take the most often seen of all would leave the newest keyframes without any.

    Args:
        keyframes: the keyframe of each of n observations.
        landmarks: number of its landmark.
        capacity: landmarks that are kept.

    Returns:
        The numbers of those kept, the best first, and for each observation its landmark's place among them,
        or -1.
    """
    numbers, inverse, counts = np.unique(landmarks, return_inverse=True, return_counts=True)
    order = np.lexsort((-counts[inverse], keyframes))
    rank = np.empty(len(order), int)
    rank[order] = np.arange(len(order)) - np.searchsorted(keyframes[order], keyframes[order])
    best = np.full(len(numbers), len(order))
    np.minimum.at(best, inverse, rank)
    kept = np.argsort(best, kind="stable")
    kept = kept[counts[kept] > 1][:capacity]
    place = np.full(len(numbers), -1)
    place[kept] = np.arange(len(kept))
    return numbers[kept], place[inverse]


def thinned(landmarks: Int[np.ndarray, " n"], most: int) -> Bool[np.ndarray, " n"]:
    """Observations that are left where a landmark that is seen often keeps some, spread evenly.

    Args:
        landmarks: landmark of each observation; those of one lie together, by keyframe.
        most: observations that a landmark keeps.
    """
    starts = np.searchsorted(landmarks, landmarks)
    count = np.searchsorted(landmarks, landmarks, side="right") - starts
    kept, place = np.minimum(most, count), np.arange(len(landmarks)) - starts
    return (place + 1) * kept // count > place * kept // count
