"""Normals of Gaussians, as features to composite."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, dot
from sfgs_jax.geometry import se3
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting._projection import rotation_columns


@checked
def camera_normals(gaussians: Gaussians, T_world_cam: se3.Pose) -> Float[Array, "n 3"]:
    """Unit normals of the Gaussians in camera axes: the shortest axis of each, turned towards the camera.

    They are `features` for `render`. The function `unit_normals` makes normals of the composited features.
    Differentiable in the quaternions and in the pose. The choice of the axis and its sense has no gradient.

    Args:
        gaussians: the map; of axes of one length the first counts as the shortest.
        T_world_cam: pose of the camera.

    Returns:
        Normals; zeros in slots that are not valid.
    """
    return _camera_normals(gaussians, se3.as_se3(T_world_cam))


# Compiled here: dozens of small programs would take longer. Inside a caller's jit it is inlined.
@jax.jit
def _camera_normals(gaussians: Gaussians, T_world_cam: jaxlie.SE3) -> Float[Array, "n 3"]:
    valid = gaussians.valid
    R_cam_world = se3.rotation_matrix(T_world_cam).T
    quaternion = [jnp.where(valid, gaussians.quaternions[:, i], 1) for i in range(4)]
    axes = rotation_columns(quaternion)
    shortest = jnp.argmin(gaussians.log_scales, axis=1)
    normal = [
        jnp.where(shortest == 0, axes[0][i], jnp.where(shortest == 1, axes[1][i], axes[2][i]))
        for i in range(3)
    ]
    away = [jnp.where(valid, gaussians.means[:, i] - T_world_cam.translation()[i], 0) for i in range(3)]
    sign = jnp.where(dot(normal, away) > 0, -1, 1).astype(gaussians.means.dtype)
    in_camera = [jnp.where(valid, sign * dot(row, normal), 0) for row in R_cam_world]
    return jnp.stack(in_camera, axis=-1)


@checked
@partial(jax.jit, static_argnames="least")
def unit_normals(composited: Float[Array, "h w 3"], *, least: float = 1e-3) -> Float[Array, "h w 3"]:
    """An image of normals of length 1 from composited normals.

    Args:
        composited: sums of weights times normals, the `features` of a rendering.
        least: length below which a pixel has no normal and holds zeros.
    """
    squares = jnp.sum(composited**2, axis=-1, keepdims=True)
    some = squares > least**2
    return jnp.where(some, composited, 0) / jnp.sqrt(jnp.where(some, squares, 1))
