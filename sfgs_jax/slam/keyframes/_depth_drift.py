"""Drift by what is not known about depth: all registrations have it in common.

An error of depth bends every registration of a run alike. So what it moves the keyframes by adds up along the
way, where errors that each registration has of its own average out.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._keyframe_graph import KeyframeGraph


def drift_of_followers(
    sensitivity: Float[np.ndarray, "6 G"], motions: Float[np.ndarray, "n 4 4"]
) -> Float[np.ndarray, "n 6 G"]:
    """How cameras move with a keyframe, as long as their motions from it stay.

    Args:
        sensitivity: derivative of the keyframe's tangent by the errors of depth.
        motions: `T_keyframe_cam` of the cameras.
    """
    return se3.adjoints_of(np.linalg.inv(motions)) @ sensitivity


def with_drift_since(graph: KeyframeGraph, first: int) -> KeyframeGraph:
    """The graph after the edge that a keyframe was tracked by has become known; later ones move with it.

    Args:
        graph: with that edge.
        first: number of the keyframe.
    """
    own = {(e.target, e.source): e.sensitivity for e in graph.edges if e.source >= first}
    newest, found = graph.keyframes[first:], graph.depth_sensitivities.copy()
    motions = se3.matrices_of(np.stack([keyframe.T_reference_keyframe for keyframe in newest]))
    for number, (keyframe, motion) in enumerate(zip(newest, motions, strict=True), first):
        reference = keyframe.reference
        if reference != number:  # the first of a map stays where it is
            moved = drift_of_followers(found[reference], motion[None])[0]
            found[number] = moved + own.get((reference, number), 0.0)
    return replace(graph, depth_sensitivities=found)
