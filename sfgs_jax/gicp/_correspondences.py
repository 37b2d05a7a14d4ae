"""Data association: the target surface that each source point meets.

In an organised target that is the surface at the point's pixel, in an unorganised one the nearest point.
"""

from typing import assert_never

import equinox as eqx
import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import (
    INDICES,
    Symmetric,
    checked,
    dot,
    identity_like,
    packed_argmin,
    smallest_eigenpair,
    upper_triangles,
)
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.gicp._config import GicpConfig, at_level
from sfgs_jax.gicp._distance_noise import DistanceNoise
from sfgs_jax.gicp._exact_products import exact_products
from sfgs_jax.gicp._sweep import RowMotion
from sfgs_jax.gicp.clouds import OrganisedLevel, PointLevel, SpatialHash, nearest
from sfgs_jax.sensors import carried, row_places, turned

_NEAREST_SLOTS = 32
"""Most candidates in the search for the nearest point."""


class SourcePoints(eqx.Module):
    """Source points to align, one coordinate a row: XLA vectorises arithmetic on rows.

    Attributes:
        points: (3, N) metres, source coordinates.
        normals: (3, N) unit normals.
        variance: (N,) or (1,) variance expected of a distance along the normal, square metres.
        valid: (N,) mask.
        rows: (N,) `row_places` of the points in the depth image; None for a list.
        oriented: whether the normals face the sensor; else they have either sign. Static.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    variance: Float[Array, " V"]
    valid: Bool[Array, " N"]
    rows: Float[Array, " N"] | None
    oriented: bool = eqx.field(static=True)


class TargetSurface(eqx.Module):
    """Target surface, one pixel or point a row: a gather copies whole rows.

    Attributes:
        rows: (M, C) point of each pixel or point, 0 where there is no surface. For C = 6 its normal follows,
            for C = 9 the upper triangle of a Gaussian's covariance, for C = 3 nothing.
        variance: share of the target in a distance's variance, square metres.
        max_distance: largest distance of a correspondence, metres.
        min_normal_cosine: least cosine between the normals of a correspondence.
        search: camera of an organised target, hash of an unorganised one.
        oriented: whether the normals face the sensor; static.
        window: radius of the window around a point's pixel in which the nearest one is looked for; static.
    """

    rows: Float[Array, "M C"]
    variance: Float[Array, ""]
    max_distance: Float[Array, ""]
    min_normal_cosine: Float[Array, ""]
    search: Camera | SpatialHash
    oriented: bool = eqx.field(static=True)
    window: int = eqx.field(static=True, default=0)


class Correspondences(eqx.Module):
    """Target surface that each source point meets, in *source* coordinates.

    In those the Jacobian of a right perturbation depends on the source point alone.

    Attributes:
        points: (3, N) target points, metres.
        normals: (3, N) target normals; the source's own where the target has none.
        covariances: (6, N) covariances of a Gaussian target, with a largest variance of about 1; else None.
        variance: (N,) variance expected of a distance along the normal, square metres.
        in_view: (N,) whether the target looks where the point is, be there a surface or a hole.
        overlap: (N,) whether the point meets a surface, near or not.
        valid: (N,) whether it meets one that passes the gates of distance and normals.
    """

    points: Float[Array, "3 N"]
    normals: Float[Array, "3 N"]
    covariances: Symmetric | None
    variance: Float[Array, " N"]
    in_view: Bool[Array, " N"]
    overlap: Bool[Array, " N"]
    valid: Bool[Array, " N"]


def source_points(level: OrganisedLevel | PointLevel, stride: int, noise: DistanceNoise) -> SourcePoints:
    """Points of a level as source; of an organised one every stride-th row and column."""
    if isinstance(level, PointLevel):
        variance = level.deviation[None] ** 2
        return SourcePoints(level.points.T, level.normals.T, variance, level.valid, None, oriented=False)
    surface, valid = (x[::stride, ::stride] for x in (level.surface, level.valid))
    columns = surface.reshape(-1, 6).T
    variance = noise.deviation(columns[2]) ** 2
    height = level.camera.height
    rows = row_places(jnp.arange(0, height, stride, dtype=columns.dtype), height)
    rows = jnp.broadcast_to(rows[:, None], valid.shape).reshape(-1)
    return SourcePoints(columns[:3], columns[3:], variance, valid.reshape(-1), rows, oriented=True)


def with_moving_rows(source: SourcePoints, moving: RowMotion) -> SourcePoints:
    """Points of a depth image at the time of its frame, whose rows were read while the camera moved.

    Args:
        source: points as they were read.
        moving: the motion.
    """
    assert source.rows is not None
    times = moving.timing.depth_times(source.rows)
    points, normals = carried(source.points, moving.twist, times), turned(source.normals, moving.twist, times)
    return eqx.tree_at(lambda s: (s.points, s.normals), source, (points, normals))


def target_surface(level: OrganisedLevel | PointLevel, index: int, config: GicpConfig) -> TargetSurface:
    """Surface of a level as target; `index` counts from the finest."""
    cosine = at_level(config.min_normal_cosine, index)
    if isinstance(level, OrganisedLevel):
        rows = level.surface.reshape(-1, 6)
        zero = jnp.zeros((), rows.dtype)
        return TargetSurface(
            rows=rows,
            variance=zero,
            max_distance=zero + at_level(config.max_distance, index),
            min_normal_cosine=zero + cosine,
            search=level.camera,
            oriented=True,
            window=at_level(config.windows, index),
        )
    match level.covariance:
        case "neighbours":
            rows = jnp.concatenate([level.points, level.normals], axis=1)
        case "map":
            rows = jnp.concatenate([level.points, _normalised(level.covariances, config.epsilon)], axis=1)
        case "isotropic":
            rows = level.points
        case _:
            assert_never(level.covariance)
    reach = config.max_voxels * level.voxel_size
    return TargetSurface(
        rows=rows,
        variance=level.deviation**2,
        max_distance=reach,
        min_normal_cosine=jnp.full_like(reach, cosine),
        search=level.grid,
        oriented=False,
    )


def _normalised(covariances: Float[Array, "M 3 3"], epsilon: float) -> Float[Array, "M 6"]:
    """Covariances divided by their largest variance, with at least `epsilon` in every direction."""
    triangles = upper_triangles(covariances)
    trace = triangles[0] + triangles[3] + triangles[5]
    identity = identity_like(trace)
    # The smallest eigenvalue of trace I - A is the trace less the largest of A.
    largest = trace - smallest_eigenpair(trace[None] * identity - triangles)[0]
    scaled = triangles / jnp.where(largest > 0, largest, 1)[None]
    return ((1 - epsilon) * scaled + epsilon * identity).T


@checked
def associate(
    source: SourcePoints, target: TargetSurface, T_target_source: jaxlie.SE3
) -> tuple[Correspondences, Int[Array, " N"]]:
    """Correspondences at a motion, and the row of the target that each is.

    Args:
        source: points to align.
        target: surface to align them with.
        T_target_source: the motion.
    """
    index, found = _search(source, target, T_target_source)
    pairs = correspondences_of_rows(source, target, T_target_source, index, found)
    offset = source.points - pairs.points
    near = dot(offset, offset) < target.max_distance**2
    alike = dot(pairs.normals, source.normals) > target.min_normal_cosine
    # A pixel without a surface has a zero normal, which is like none.
    overlap = found & (dot(pairs.normals, pairs.normals) > 0)
    return eqx.tree_at(lambda p: (p.overlap, p.valid), pairs, (overlap, found & near & alike)), index


@exact_products
def correspondences_of_rows(
    source: SourcePoints,
    target: TargetSurface,
    T_target_source: jaxlie.SE3,
    index: Int[Array, " N"],
    valid: Bool[Array, " N"],
) -> Correspondences:
    """Correspondences with given rows of the target, in source coordinates.

    Args:
        source: points to align.
        target: surface to align them with.
        T_target_source: motion that takes the source to the target.
        index: row of the target for each source point.
        valid: which correspondences count.
    """
    rotation, translation = se3.rotation_matrix(T_target_source), T_target_source.wxyz_xyz[4:]
    rows = target.rows.at[index].get(mode="promise_in_bounds")
    width = rows.shape[1]

    # One product turns everything into source coordinates and rows into columns.
    turn = jnp.zeros((width, width), rotation.dtype).at[:3, :3].set(rotation.T)
    if width == 6:
        turn = turn.at[3:, 3:].set(rotation.T)
    elif width == 9:
        turn = turn.at[3:, 3:].set(_symmetric_rotation(rotation.T))
    turned = turn @ rows.T
    points = turned[:3] - (rotation.T @ translation)[:, None]
    normals, covariances = source.normals, None
    if width == 6:
        normals = turned[3:]
        if not (source.oriented and target.oriented):
            normals = jnp.where(dot(normals, source.normals) < 0, -normals, normals)
    elif width == 9:
        covariances = turned[3:]
    return Correspondences(
        points=points,
        normals=normals,
        covariances=covariances,
        variance=jnp.broadcast_to(source.variance + target.variance, valid.shape),
        in_view=valid,
        overlap=valid,
        valid=valid,
    )


def _symmetric_rotation(rotation: Float[Array, "3 3"]) -> Float[Array, "6 6"]:
    """Matrix that maps the upper triangle of A to that of R A R^T."""
    full = jnp.einsum("ia,jb->ijab", rotation, rotation)
    columns = [full[:, :, a, b] if a == b else full[:, :, a, b] + full[:, :, b, a] for a, b in INDICES]
    stacked = jnp.stack(columns, axis=-1)
    return jnp.stack([stacked[i, j] for i, j in INDICES])


@exact_products
def _search(
    source: SourcePoints, target: TargetSurface, T_target_source: jaxlie.SE3
) -> tuple[Int[Array, " N"], Bool[Array, " N"]]:
    """Row of the target that each source point meets, and whether there is one."""
    rotation, translation = se3.rotation_matrix(T_target_source), T_target_source.wxyz_xyz[4:]
    moved = rotation @ source.points + translation[:, None]
    if isinstance(target.search, SpatialHash):
        index, found = nearest(target.search, moved, slots=_NEAREST_SLOTS)
        return index, found & source.valid
    index, inside = _window_rows(target.search, moved, target.window)
    if target.window > 0:
        surface = jnp.any(target.rows[:, 3:6] != 0, axis=1, keepdims=True)
        # One coordinate at a time: XLA takes much longer for triples.
        columns = jnp.where(surface, target.rows[:, :3], jnp.inf).T
        square = sum(
            (m[None] - c.at[index].get(mode="promise_in_bounds")) ** 2
            for m, c in zip(moved, columns, strict=True)
        )
        square = jnp.where(inside, square, jnp.inf)
        best = packed_argmin(square)[None]
        index, inside = (jnp.take_along_axis(x, best, axis=0) for x in (index, inside))
    return index[0], inside[0] & source.valid


def _window_rows(
    camera: Camera, points: Float[Array, "3 N"], window: int
) -> tuple[Int[Array, "K N"], Bool[Array, "K N"]]:
    """Rows of the pixels in the window around each point's pixel, and whether they are in the image."""
    x, y, z = points
    inverse = 1 / jnp.maximum(z, 1e-6)
    shifts = jnp.arange(-window, window + 1, dtype=x.dtype)
    du, dv = (shift.reshape(-1, 1) for shift in jnp.meshgrid(shifts, shifts))
    u = jnp.round(camera.fx * x * inverse + camera.cx)[None] + du
    v = jnp.round(camera.fy * y * inverse + camera.cy)[None] + dv
    inside = (z > 0)[None] & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    return jnp.where(inside, v * camera.width + u, 0).astype(jnp.int32), inside
