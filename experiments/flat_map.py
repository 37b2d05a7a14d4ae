"""A Gaussian map without optimisation: one flat Gaussian on the surface for every few pixels of its views."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, quaternions_from_rotations, surface
from sfgs_jax.splatting import Gaussians, rgb_to_sh

THICKNESS = 0.002
"""Standard deviation of a Gaussian along the surface's normal, metres."""
OPACITY_LOGIT = 3.0


def flat_gaussians(
    rgb: Float[np.ndarray, "H W 3"],
    depth: Float[np.ndarray, "H W"],
    camera: Camera,
    T_world_cam: Float[np.ndarray, "4 4"],
    stride: int = 2,
) -> Gaussians:
    """Gaussians of one view, in world coordinates; pixels without a plane have none.

    Args:
        rgb: colours in [0, 1].
        depth: metres along z; 0 where missing.
        camera: intrinsics of the view.
        T_world_cam: its pose.
        stride: pixels from one Gaussian to the next, along rows and columns.
    """
    found = jax.device_get(surface(depth, camera))
    part = (slice(stride // 2, None, stride),) * 2
    points, normals, valid, colours = (
        x[part].reshape(-1, *x.shape[2:]) for x in (found.points, found.normals, found.valid, rgb)
    )
    normals = np.where(valid[:, None], normals, np.asarray([0.0, 0.0, -1.0]))
    # A Gaussian is as wide as its pixels, and longer where the surface is slanted.
    width = 0.6 * stride * np.maximum(points[:, 2], 0.1) / float(camera.fx)
    slant = np.clip(-np.sum(normals * points, axis=1) / np.linalg.norm(points + 1e-6, axis=1), 0.3, 1)
    thickness = np.full_like(width, THICKNESS)
    turned = T_world_cam[:3, :3] @ tangent_frames(normals, points)
    return Gaussians(
        means=jnp.asarray(points @ T_world_cam[:3, :3].T + T_world_cam[:3, 3], jnp.float32),
        quaternions=jnp.asarray(quaternions_from_rotations(turned), jnp.float32),
        log_scales=jnp.asarray(np.log(np.stack([width, width / slant, thickness], axis=1)), jnp.float32),
        opacity_logits=jnp.full(len(points), OPACITY_LOGIT),
        sh=rgb_to_sh(jnp.asarray(colours, jnp.float32))[:, None],
        valid=jnp.asarray(valid),
    )


def tangent_frames(
    normals: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3 3"]:
    """Rotations whose columns lie across the view, along the slope of the surface, and along its normal.

    Args:
        normals: unit vectors that face the camera.
        points: places on the surface, camera coordinates.
    """
    across = np.cross(normals, points)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    head_on = length < 1e-3 * np.maximum(points[:, 2:], 0.1)
    across = np.where(head_on, np.cross(normals, np.asarray([0.0, 1.0, 0.0])), across)
    across = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
    return np.stack([across, np.cross(normals, across), normals], axis=2)


def merged(parts: Sequence[Gaussians]) -> Gaussians:
    """One map of several views' Gaussians; those without a place on a surface are left out."""
    kept = [jax.tree.map(lambda x, p=part: x[np.asarray(p.valid)], part) for part in parts]
    return jax.tree.map(lambda *x: jnp.concatenate(x), *kept)
