"""Derivatives of a registration's residuals by the errors of depth that all frames have in common.

Source and target have the same errors. They show in a registration where the two frames see a point at other
places of the image, or from another side.
"""

from typing import NamedTuple

import jax.numpy as jnp
import jaxlie
from jax.lax import Precision
from jaxtyping import Array, Float

from sfgs_jax.arrays import dot
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import depth_slopes, grid_shares
from sfgs_jax.slam.frontend._registration_rows import KeypointRows, SurfaceRows
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._registration import FeatureRegistration


class ByDepth(NamedTuple):
    """Derivatives by the G parameters of a `DepthCorrection`. To join them would take longer than products.

    Attributes:
        grid: (R C, N) by the offsets.
        extrinsic: (6, N) by the extrinsic.
    """

    grid: Float[Array, "m N"]
    extrinsic: Float[Array, "6 N"]


def surface_by_depth(
    rows: SurfaceRows, weight: Float[Array, " N"], camera: Camera, T_target_source: jaxlie.SE3
) -> ByDepth:
    """Derivatives of the distances between two surfaces.

    Taken between the two surfaces. At the measured points they would have their noise in them. Then offsets
    that shrink the scene, and all noise with it, would seem to fit better.

    Args:
        rows: the distances.
        weight: (N,) of these; where it is 0, the derivatives are too, or may be anything finite.
        camera: of the level that the rows are a sample of.
        T_target_source: the motion.
    """
    inside = jnp.asarray([[0], [0], [1]], rows.points.dtype)
    between = jnp.where(weight[None] > 0, (rows.points + rows.targets) / 2, inside)
    seen = se3.transform(T_target_source, between.T)
    in_target = jnp.matmul(se3.rotation_matrix(T_target_source), rows.normals, precision=Precision.HIGHEST)
    by_source, by_target = (
        (grid_shares(camera.project(x.T), camera) * (dot(x, n) * x[2])[None], se3.plane_jacobian(x, n))
        for x, n in ((between, rows.normals), (seen.T, in_target))
    )
    return ByDepth(*(a - b for a, b in zip(by_source, by_target, strict=True)))


def keypoints_by_depth(
    rows: KeypointRows,
    source: FrameFeatures,
    target: FrameFeatures,
    matched: FeatureRegistration,
    camera: Camera,
    T_target_source: jaxlie.SE3,
) -> list[ByDepth]:
    """Derivatives of the matches' errors: along the image's axes, and in inverse depth.

    The target's points move along their rays, and so does what is measured at the source's keypoints.

    Args:
        rows: the errors.
        source: the frame that was registered.
        target: the frame that it was registered to.
        matched: the matches.
        camera: intrinsics.
        T_target_source: the motion.
    """
    pixels, seen = matched.pixels, target.keypoints.points[matched.index]
    turned = jnp.matmul(se3.rotation_matrix(T_target_source).T, seen.T, precision=Precision.HIGHEST)
    along = jnp.sum(rows.at.point_jacobian * turned[None], axis=1)
    target_pixels = target.keypoints.features.keypoints[matched.index]
    grid = grid_shares(target_pixels, camera) * seen[:, 2][None]
    slopes = depth_slopes(seen.T, target.keypoints.normals[matched.index].T)
    depth = source.keypoints.depth
    own_grid = grid_shares(pixels, camera)
    own_slopes = depth_slopes(source.keypoints.points.T, source.keypoints.normals.T)
    own_slopes /= jnp.where(depth > 0, depth, 1)[None]

    def along_axis(by_target: Float[Array, " K"], by_source: Float[Array, " K"]) -> ByDepth:
        parts = ((grid, own_grid), (slopes, own_slopes))
        return ByDepth(*(by_target[None] * of - by_source[None] * own for of, own in parts))

    return [along_axis(*by) for by in zip(along, rows.by_measured, strict=True)]
