"""Nodes and edges of the graph of keyframes."""

from dataclasses import dataclass

import jaxlie
import numpy as np
from jaxtyping import Array, Float, Int

from sfgs_jax.slam.observation import Observation
from sfgs_jax.slam.pytrees import pytree


@pytree
@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame that others are registered to: a node of the graph.

    Attributes:
        observation: its surface and keypoints.
        T_world_cam: its pose.
        landmarks: (K,) number of the landmark that each keypoint shows, -1 where it shows none.
        frame: number of the frame it was.
    """

    observation: Observation
    T_world_cam: jaxlie.SE3
    landmarks: Int[np.ndarray, " k"]
    frame: int


@pytree
@dataclass(frozen=True, eq=False)
class Edge:
    """A registration of one keyframe to another.

    Attributes:
        target: number of the keyframe registered to.
        source: number of the keyframe registered, the later one.
        T_target_source: the motion found.
        information: (6, 6) of its tangent, by surface and keypoints.
        surface_information: (6, 6) by the surface alone.
        loop: whether it closes a loop.
    """

    target: int
    source: int
    T_target_source: jaxlie.SE3
    information: Float[Array, "6 6"]
    surface_information: Float[Array, "6 6"]
    loop: bool
