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
    """Values moved by a step: landmarks by addition, poses on the right.

    To first order a pose moves as by `T @ exp(step)`, but its rotation and its origin each go their own way:
    R exp(w), t + R v. The exponential would bend the origin's path by w x v / 2, while residuals between
    origins are nearly linear along straight ones: long steps then keep closer to what the model expects.
    """
    v, w = pose_steps[:, :3], pose_steps[:, 3:]
    turned = se3.compose(values.poses, se3.exp(jnp.concatenate([jnp.zeros_like(v), w], axis=1)))
    moved = jnp.einsum("pij,pj->pi", se3.rotation_matrix(values.poses), v)
    origin = values.poses.wxyz_xyz[:, 4:] + moved
    poses = jaxlie.SE3(jnp.concatenate([turned.wxyz_xyz[:, :4], origin], axis=1))
    return Values(poses, values.landmarks + landmark_steps)
