"""The variables of a graph and how a step moves them."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.geometry import se3


class Values(eqx.Module):
    """Poses and landmarks; lanes beyond those in use hold any finite value.

    Attributes:
        poses: motions (P,), `T_world_pose`.
        landmarks: (L, 3) points in the world, metres; L may be 0.
    """

    poses: jaxlie.SE3
    landmarks: Float[Array, "L 3"]

    def __init__(self, poses: jaxlie.SE3, landmarks: Float[Array, "L 3"] | None = None):
        self.poses = poses
        self.landmarks = jnp.zeros((0, 3), poses.wxyz_xyz.dtype) if landmarks is None else landmarks


def retract(values: Values, pose_steps: Float[Array, "P 6"], landmark_steps: Float[Array, "L 3"]) -> Values:
    """Values moved by a step: poses on the right, `T @ exp(step)`; landmarks by addition."""
    poses = se3.compose(values.poses, se3.exp(pose_steps))
    return Values(poses, values.landmarks + landmark_steps)
