"""Matches whose places are refined by patches, and those left out whose patches differ."""

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float

from sfgs_jax.arrays import dot
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.frontend._least_reprojection import MatchedRows
from sfgs_jax.slam.frontend._patch_alignment import (
    PatchPairs,
    aligned,
    aligned_again,
    patch_factor,
    reduced,
)
from sfgs_jax.slam.state._frame_features import FrameFeatures
from sfgs_jax.slam.state._tracker import TrackerParams

_DETECTED = 2.0
"""Standard deviation of a keypoint's place as detected, along each axis, pixels: half a pixel as a rule, and
four beside an outline."""
_LEAST_AREA, _MOST_AREA = 0.1, 10.0
"""Change of a patch's area between two images beyond which it is compared upright."""


def with_aligned_places(
    T_target_source: jaxlie.SE3,
    rows: MatchedRows,
    source: FrameFeatures,
    target: FrameFeatures,
    params: TrackerParams,
    found: Float[Array, "M 2"] | None = None,
) -> MatchedRows:
    """Matches at the places at which the source looks like the target, and only those that do.

    Args:
        T_target_source: the motion by keypoints as they were detected, which says how patches are warped.
        rows: matches at these places.
        source: the frame to locate, with the keypoints of these matches alone.
        target: the frame to locate it in, likewise.
        params: parameters of tracking.
        found: pixels (u, v) as an earlier call has found them; they get their derivatives.
    """
    camera = params.camera
    factor = patch_factor(camera.width)
    pairs = PatchPairs(
        source.grey,
        target.grey,
        reduced(source.keypoints.places, camera),
        reduced(target.keypoints.places, camera),
        _warps(T_target_source, rows, target.keypoints.normals, camera),
        jnp.asarray(_DETECTED / factor, source.grey.dtype),
    )
    if found is None:
        shift, agreement = aligned(pairs, steps=params.config.features.patch_steps)
    else:
        shift, agreement = aligned_again((found - rows.pixels).T / factor, pairs)
    agree = agreement >= params.config.features.min_patch_agreement
    return rows._replace(
        pixels=rows.pixels + factor * shift.T,
        valid=rows.valid & agree,
        sigma=params.noise.pixels,
        width=params.config.features.matched_kernel_width,
    )


def _warps(
    T_target_source: jaxlie.SE3,
    rows: MatchedRows,
    normals: Float[Array, "M 3"],
    camera: Camera,
) -> Float[Array, "2 2 M"]:
    """Derivative of the target's pixels by the source's, across the planes of the target's points."""
    ahead = jnp.asarray([0, 0, 1], rows.points.dtype)
    points = jnp.where(rows.valid[:, None], rows.points, ahead)
    known = jnp.sum(normals**2, axis=1) > 0
    normals = jnp.where(known[:, None], normals, -ahead).T
    at, distance = camera.project(points), dot(normals, points.T)
    T_source_target = se3.inverse(T_target_source)

    def seen(step: tuple[float, float]) -> Float[Array, "M 3"]:
        rays = camera.unproject(at + jnp.asarray([step], at.dtype), jnp.ones_like(distance)).T
        along = dot(normals, rays)
        # Beyond 84 degrees a pixel's width becomes ten in depth.
        depth = distance / jnp.where(along < -0.1, along, -0.1)
        return se3.transform(T_source_target, (rays * depth[None]).T)

    places = [seen(step) for step in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0))]
    front = jnp.all(jnp.stack([place[:, 2] for place in places]) > 0.01, axis=0)
    here, right, below = (camera.project(jnp.where(front[:, None], place, ahead)) for place in places)
    (a, c), (b, d) = (right - here).T, (below - here).T
    area = a * d - b * c
    sound = front & (area > _LEAST_AREA) & (area < _MOST_AREA)
    inverse = jnp.stack([jnp.stack([d, -b]), jnp.stack([-c, a])]) / jnp.where(sound, area, 1)[None, None]
    return jnp.where(sound[None, None], inverse, jnp.eye(2, dtype=at.dtype)[..., None])
