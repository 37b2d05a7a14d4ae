"""From 3-D Gaussians to their images: EWA splatting.

A Gaussian's image has the 2 x 2 covariance Σ = M Mᵀ + 0.3 I, M = J R S: S its scales, R its rotation to
camera axes, J the derivative of the projection at its centre. What the pixels need is Σ⁻¹; it is kept as
the triangle U of Σ⁻¹ = Uᵀ U, so that the exponent -|U d|² / 2 is a sum of squares. With det Σ from
Cauchy-Binet, |m₁ x m₂|² + 0.3 (|m₁|² + |m₂|²) + 0.09 for the rows m of M, nothing cancels: a needle
hundreds of pixels long and half a pixel wide is exact in float32, where the entries of Σ⁻¹ are not.

Source: Zwicker et al., EWA splatting, 2002; Kerbl et al., 3D Gaussian splatting, 2023.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.splatting.config import DEFAULT, RenderConfig
from sfgs_jax.splatting.gaussians import Gaussians
from sfgs_jax.splatting.harmonics import sh_colours

LOW_PASS = 0.3
"""Variance added to both axes of every image, pixels²: no Gaussian falls between pixels."""

MIN_ALPHA = 1 / 255
"""Contributions below this are skipped."""

_VIEW_MARGIN = 0.3
"""J is taken no farther outside the image than this part of its half size; the linearisation fails there."""


class Projected(eqx.Module):
    """Images of N Gaussians.

    Attributes:
        centres: (N, 2) pixels (u, v).
        whitening: (N, 3) entries p, q, r of U = [[p, q], [0, r]], 1 / pixels; Σ⁻¹ = Uᵀ U.
        log_opacities: (N,) logarithms of the opacities.
        depths: (N,) depth of the centres along z, metres.
        visible: (N,) which are drawn at all; the other lanes hold finite values.
    """

    centres: Float[Array, "n 2"]
    whitening: Float[Array, "n 3"]
    log_opacities: Float[Array, " n"]
    depths: Float[Array, " n"]
    visible: Bool[Array, " n"]


def project(
    gaussians: Gaussians, camera: Camera, T_world_cam: jaxlie.SE3, *, config: RenderConfig = DEFAULT
) -> tuple[Projected, Float[Array, "n 3"]]:
    """Images of the Gaussians, and their RGB as seen from the camera.

    Differentiable by ordinary means, with zero gradients in lanes that are not visible: unused, outside
    [near, far], too transparent, or off the image.
    """
    # Relative to the camera before anything else: far from the origin float32 has no digits to spare.
    offsets = gaussians.means - T_world_cam.wxyz_xyz[4:]
    R_cam_world = se3.rotation_matrix(T_world_cam).T
    z = offsets @ R_cam_world[2]
    used = gaussians.valid & (z > config.near) & (z < config.far)

    # Lanes not in use are replaced on the way in, so that no NaN arises there, nor in a gradient.
    offsets = jnp.where(used[:, None], offsets, R_cam_world[2])
    quaternions = jnp.where(used[:, None], gaussians.quaternions, 1)
    log_scales = jnp.where(used[:, None], gaussians.log_scales, 0)
    logits = jnp.where(used, gaussians.opacity_logits, 0)
    sh = jnp.where(used[:, None, None], gaussians.sh, 0)

    x, y, z = (offsets @ R_cam_world[i] for i in range(3))
    centres = jnp.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], axis=-1)
    m1, m2 = _image_axes(x, y, z, quaternions, log_scales, camera, R_cam_world)

    raw_determinant = jnp.sum(jnp.cross(m1, m2) ** 2, axis=-1)
    raw_uu, raw_vv = jnp.sum(m1**2, axis=-1), jnp.sum(m2**2, axis=-1)
    determinant = raw_determinant + LOW_PASS * (raw_uu + raw_vv) + LOW_PASS**2
    vv, uv = raw_vv + LOW_PASS, jnp.sum(m1 * m2, axis=-1)
    p = jnp.sqrt(vv / determinant)
    whitening = jnp.stack([p, -p * uv / vv, 1 / jnp.sqrt(vv)], axis=-1)

    log_opacities = jax.nn.log_sigmoid(logits)
    if config.antialiased:
        kept = jnp.maximum(raw_determinant / determinant, 1e-12)
        log_opacities = log_opacities + 0.5 * jnp.log(kept)

    reach = 2 * (log_opacities - math.log(MIN_ALPHA))
    extent_u = jnp.sqrt(jnp.maximum(reach, 0) * (raw_uu + LOW_PASS))
    extent_v = jnp.sqrt(jnp.maximum(reach, 0) * vv)
    visible = (
        used
        & (reach >= 0)
        & (centres[:, 0] + extent_u >= 0)
        & (centres[:, 0] - extent_u <= camera.width - 1)
        & (centres[:, 1] + extent_v >= 0)
        & (centres[:, 1] - extent_v <= camera.height - 1)
    )
    return Projected(centres, whitening, log_opacities, z, visible), sh_colours(sh, offsets)


def _image_axes(
    x: Float[Array, " n"],
    y: Float[Array, " n"],
    z: Float[Array, " n"],
    quaternions: Float[Array, "n 4"],
    log_scales: Float[Array, "n 3"],
    camera: Camera,
    R_cam_world: Float[Array, "3 3"],
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Rows of M = J R S: how the image moves, in u and in v, along each axis of the Gaussian by one sigma."""
    # Pixels cover half a unit around their centres, so the image spans [-0.5, size - 0.5].
    margin_u = _VIEW_MARGIN * camera.width / (2 * camera.fx)
    margin_v = _VIEW_MARGIN * camera.height / (2 * camera.fy)
    slope_u = jnp.clip(
        x / z,
        -(camera.cx + 0.5) / camera.fx - margin_u,
        (camera.width - 0.5 - camera.cx) / camera.fx + margin_u,
    )
    slope_v = jnp.clip(
        y / z,
        -(camera.cy + 0.5) / camera.fy - margin_v,
        (camera.height - 0.5 - camera.cy) / camera.fy + margin_v,
    )
    # J R_cam_world, row by row, then the quaternion's columns: no (N, 3, 3) products are needed.
    j1 = (camera.fx / z)[:, None] * (R_cam_world[0] - slope_u[:, None] * R_cam_world[2])
    j2 = (camera.fy / z)[:, None] * (R_cam_world[1] - slope_v[:, None] * R_cam_world[2])
    columns = _rotation_columns(quaternions)
    scales = jnp.exp(log_scales)
    m1 = jnp.stack([jnp.sum(j1 * column, axis=-1) for column in columns], axis=-1) * scales
    m2 = jnp.stack([jnp.sum(j2 * column, axis=-1) for column in columns], axis=-1) * scales
    return m1, m2


def _rotation_columns(quaternions: Float[Array, "n 4"]) -> list[Float[Array, "n 3"]]:
    """Columns of the rotation matrices of quaternions wxyz of any positive length."""
    unit = quaternions / jnp.linalg.norm(quaternions, axis=-1, keepdims=True)
    w, x, y, z = (unit[:, i] for i in range(4))
    return [
        jnp.stack(column, axis=-1)
        for column in (
            [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)],
            [2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)],
            [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)],
        )
    ]
