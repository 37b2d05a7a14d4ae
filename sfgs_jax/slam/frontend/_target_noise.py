"""Noise of the target's points in reprojection errors.

A match is measured twice: the source tells a pixel and a depth, and so does the target. If the target is
thought exact, the noise of its depth is taken for motion. The farther the camera has moved, the more of it
shows in the pixels too, along the epipolar line.

The error e = (u, v, inverse depth) of a match has the covariance I + w wᵀ, in standard deviations of what the
source measures. Here w is what one standard deviation of the target's inverse depth does to e.
"""

from dataclasses import replace

import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.geometry import ReprojectionResiduals, se3


def target_noise(
    T_target_source: jaxlie.SE3,
    points: Float[Array, "k 3"],
    at: ReprojectionResiduals,
    sigma: Float[Array, ""],
) -> Float[Array, "3 k"]:
    """Change of the errors by one standard deviation of the target's inverse depth.

    Args:
        T_target_source: the motion.
        points: in the target's camera, metres.
        at: errors, in standard deviations of what the source measures.
        sigma: standard deviation of inverse depth, 1/m.
    """
    # A point moves along its ray. Its derivative by the inverse depth 1 / z is -z times itself.
    turned = jnp.matmul(points, se3.rotation_matrix(T_target_source), precision=Precision.HIGHEST)
    moved = -sigma * (points[:, 2:] * turned).T
    return jnp.sum(at.point_jacobian * moved[None], axis=1)


def with_target_noise(at: ReprojectionResiduals, w: Float[Array, "3 k"]) -> ReprojectionResiduals:
    """Errors and derivatives in standard deviations of what both frames measure.

    Args:
        at: errors, in standard deviations of what the source measures.
        w: as of `target_noise`.
    """
    return replace(
        at,
        residual=whitened(at.residual[:, None], w)[:, 0],
        point_jacobian=whitened(at.point_jacobian, w),
        pose_jacobian=whitened(at.pose_jacobian, w),
    )


def whitened(rows: Float[Array, "3 m k"], w: Float[Array, "3 k"]) -> Float[Array, "3 m k"]:
    """Errors, or derivatives of them, times the inverse root of I + w wᵀ.

    Args:
        rows: in standard deviations of what the source measures.
        w: as of `target_noise`.
    """
    root = jnp.sqrt(1 + jnp.sum(w * w, axis=0))
    share = w / (root * (1 + root))[None]
    return rows - share[:, None] * jnp.sum(w[:, None] * rows, axis=0)[None]
