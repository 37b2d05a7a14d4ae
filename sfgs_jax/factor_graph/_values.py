"""The variables of a graph, poses and landmarks, and their retraction."""

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.geometry import se3


class Values(eqx.Module):
    """Poses and landmarks; rows beyond those in use hold any finite value.

    Attributes:
        poses: (P,) motions `T_world_pose`.
        landmarks: (L, 3) points in the world, metres; L may be 0.
    """

    poses: jaxlie.SE3
    landmarks: Float[Array, "L 3"]

    def __init__(self, poses: se3.Pose, landmarks: Float[Array, "L 3"] | None = None):
        """Values of P poses and L landmarks.

        Args:
            poses: (P,) motions `T_world_pose`, `jaxlie.SE3` or homogeneous matrices (P, 4, 4).
            landmarks: (L, 3) points, metres; none if not given.

        Raises:
            InputError: the poses are no array of motions.
        """
        self.poses = se3.as_se3(poses, name="The poses of Values", axes=None)
        if self.poses.wxyz_xyz.ndim < 2:
            raise InputError("Values take an array of poses, (P, 4, 4) as matrices, not a single pose.")
        self.landmarks = jnp.zeros((0, 3), self.poses.wxyz_xyz.dtype) if landmarks is None else landmarks


@checked
def retract(values: Values, pose_steps: Float[Array, "P 6"], landmark_steps: Float[Array, "L 3"]) -> Values:
    """Retraction: move landmarks by addition, and poses on SO(3) x R^3, perturbed on the right.

    A pose (R, t) moves to R exp(w), t + R v, which is `T @ exp(step)` to first order. The exponential of
    SE(3) would bend the path of the origin by w x v / 2. Residuals between origins are nearly linear along a
    straight path, so long steps stay closer to the linear model.

    Args:
        values: where the step begins.
        pose_steps: (P, 6) tangents, translation v first, then rotation w; metres and radians.
        landmark_steps: (L, 3) metres.

    Raises:
        InputError: there is not one step for each pose and each landmark.
    """
    counts = values.poses.wxyz_xyz.shape[0], values.landmarks.shape[0]
    if (len(pose_steps), len(landmark_steps)) != counts:
        raise InputError(
            f"pose_steps and landmark_steps of retract should have a row for each of the {counts[0]} poses "
            f"and {counts[1]} landmarks, not {len(pose_steps)} and {len(landmark_steps)}."
        )
    v, w = pose_steps[:, :3], pose_steps[:, 3:]
    turned = se3.compose(values.poses, se3.exp(jnp.concatenate([jnp.zeros_like(v), w], axis=1)))
    rotations = se3.rotation_matrix(values.poses)
    moved = jnp.einsum("pij,pj->pi", rotations, v, precision=Precision.HIGHEST)
    origin = values.poses.wxyz_xyz[:, 4:] + moved
    poses = jaxlie.SE3(jnp.concatenate([turned.wxyz_xyz[:, :4], origin], axis=1))
    return Values(poses, values.landmarks + landmark_steps)
