"""Identity of landmarks: keypoints of several keyframes that show the same point."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Int

from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph
from sfgs_jax.slam.state._registration import Registration


def share_landmarks(graph: KeyframeGraph, target: int, source: int, found: Registration) -> KeyframeGraph:
    """The graph in which the matched keypoints of two keyframes show the same landmarks.

    A keypoint that shows a landmark already hands it on; the others start one.

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
    number = graph.num_landmarks
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
    return replace(graph, keyframes=tuple(keyframes), num_landmarks=number)


def most_seen(
    landmarks: Int[np.ndarray, "w k"], capacity: int
) -> tuple[Int[np.ndarray, "w k"], Bool[np.ndarray, "w k"]]:
    """Landmarks seen at least twice, counted anew from 0, the most often seen first.

    Args:
        landmarks: number of the landmark that each keypoint shows, -1 where it shows none.
        capacity: landmarks that are kept.

    Returns:
        The new number for each keypoint, and which keypoints show one of those kept.
    """
    numbers, inverse, counts = np.unique(landmarks, return_inverse=True, return_counts=True)
    counts[numbers < 0] = 0
    kept = np.argsort(-counts, kind="stable")[:capacity]
    kept = kept[counts[kept] > 1]
    place = np.full(len(numbers), -1, np.int32)
    place[kept] = np.arange(len(kept))
    index = place[inverse].reshape(landmarks.shape)
    return np.maximum(index, 0), index >= 0
