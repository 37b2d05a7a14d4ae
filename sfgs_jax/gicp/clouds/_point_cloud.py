"""Unorganised clouds: points with their local planes at several voxel sizes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from sfgs_jax.arrays import (
    InputError,
    Symmetric,
    checked_but,
    described,
    from_upper_triangles,
    is_floating,
    masked_median,
    padded,
    smallest_eigenpair,
)
from sfgs_jax.gicp._config import PointsConfig, TargetCovariance
from sfgs_jax.gicp.clouds._neighbours import neighbourhoods
from sfgs_jax.gicp.clouds._spatial_hash import SpatialHash, build_hash
from sfgs_jax.gicp.clouds._voxels import VoxelMeans, occupied_cells, voxel_means


class PointLevel(eqx.Module):
    """One resolution of an unorganised cloud, in coordinates around the cloud's `origin`.

    Attributes:
        points: (M, 3) mean points of voxels, metres; 0 where not valid.
        normals: (M, 3) unit normals, of either sign; 0 where not valid.
        covariances: (M, 3, 3) of the neighbourhood, or of the Gaussian, square metres.
        valid: (M,) whether there is a point with a normal.
        deviation: standard deviation of a point's distance from its plane, metres: root of the median of the
            neighbourhoods' smallest eigenvalues.
        voxel_size: metres.
        grid: hash of the points with cells of one voxel.
        covariance: covariance that a residual is weighted by, if the level is the target; static.
    """

    points: Float[Array, "M 3"]
    normals: Float[Array, "M 3"]
    covariances: Float[Array, "M 3 3"]
    valid: Bool[Array, " M"]
    deviation: Float[Array, ""]
    voxel_size: Float[Array, ""]
    grid: SpatialHash
    covariance: TargetCovariance = eqx.field(static=True)


class PointCloud(eqx.Module):
    """Unorganised cloud at several resolutions.

    Attributes:
        levels: from the finest to the coarsest.
        origin: (3,) origin of the levels' coordinates, metres.
        overflow: number of points and neighbours lost because a capacity was full, over all levels. Points
            are lost beyond `PointsConfig.max_points` voxels or beyond the grid, and neighbours that would
            change a normal beyond `PointsConfig.slots`.
    """

    levels: tuple[PointLevel, ...]
    origin: Float[Array, "3"]
    overflow: Int[Array, ""]


@checked_but("points")
def prepare_points(
    points: Shaped[Array | np.ndarray, "..."],
    *,
    valid: Bool[Array | np.ndarray, " N"] | None = None,
    k: int = 20,
    config: PointsConfig | None = None,
) -> PointCloud:
    """Cloud of unorganised points, ready to be source or target of `align`.

    Points are averaged over voxels, of 1, 2, 4 and more times the finest size. Each mean gets the covariance
    and the normal of its k nearest neighbours among the means. Points may be millimetres apart and kilometres
    from the origin if they come as float64 NumPy arrays: they are centred before they become float32.

    Args:
        points: (N, 3) metres, float32 or float64; rows that are not finite are left out.
        valid: rows to use, all if not given.
        k: neighbours of a covariance, the point itself among them; static.
        config: capacities and sizes, `PointsConfig()` if not given.

    Raises:
        InputError: the points are no such array, or k is out of range.
    """
    config = PointsConfig() if config is None else config
    check_neighbours(k, config)
    if not is_floating(points) or points.ndim != 2 or points.shape[1] != 3:
        raise InputError(
            f"The points are an array (N, 3) of metres, float32 or float64, not {described(points)}."
        )
    used, origin, centred = centre(points, valid)
    return _prepare_points(centred, used, origin, k, config)


def check_neighbours(k: int, config: PointsConfig) -> None:
    """Refuse a number of neighbours that makes no plane, or that the search has no room for."""
    if not 3 <= k <= config.slots:
        raise InputError(
            f"A plane needs 3 neighbours or more, and {config.slots} slots can't hold {k}: change k."
        )


def centre(
    points: Float[Array | np.ndarray, "N 3"], valid: Bool[Array | np.ndarray, " N"] | None
) -> tuple[Bool[Array, " M"], Float[Array, "3"], Float[Array, "M 3"]]:
    """Mask of the points to use, their median as the origin, and the points relative to it, in padded rows.

    A float64 array of the host is centred on the host: float32 would round it to millimetres at ten
    kilometres. It is padded there too, so that another number of points compiles nothing.
    """
    given = padded(np.ones(points.shape[0], bool) if valid is None else valid)
    points = padded(points)
    if not isinstance(points, np.ndarray):
        return _centre_on_device(points, jnp.asarray(given))
    used = np.isfinite(points).all(axis=1) & np.asarray(given)
    middle = np.median(points[used], axis=0) if used.any() else np.zeros(3)
    origin = jnp.asarray(middle, jnp.asarray(points[:0]).dtype)
    centred = np.where(used[:, None], points - np.asarray(origin, points.dtype), 0)
    return jnp.asarray(used), origin, jnp.asarray(centred, origin.dtype)


@jax.jit
def _centre_on_device(
    points: Float[Array, "M 3"], given: Bool[Array, " M"]
) -> tuple[Bool[Array, " M"], Float[Array, "3"], Float[Array, "M 3"]]:
    used = given & jnp.all(jnp.isfinite(points), axis=1)
    origin = jnp.stack([masked_median(c, used) for c in points.T])
    return used, origin, jnp.where(used[:, None], points - origin[None], 0)


@partial(jax.jit, static_argnames=("k", "config"))
def _prepare_points(
    points: Float[Array, "N 3"],
    valid: Bool[Array, " N"],
    origin: Float[Array, "3"],
    k: int,
    config: PointsConfig,
) -> PointCloud:
    no_values = jnp.zeros((points.shape[0], 0), points.dtype)
    levels, overflow = [], jnp.asarray(0, jnp.int32)
    for means in voxel_levels(points, no_values, valid, config):
        level, dropped = neighbour_level(means, k, config)
        levels.append(level)
        overflow += dropped + means.dropped
    return PointCloud(tuple(levels), origin, overflow)


def voxel_levels(
    points: Float[Array, "N 3"], values: Float[Array, "N C"], valid: Bool[Array, " N"], config: PointsConfig
) -> list[VoxelMeans]:
    """Means over voxels of the finest size, of twice that, and so on, each with half the capacity."""
    if config.voxel_size is None:
        size = _fitting_size(points, valid, config)
    else:
        size = jnp.asarray(config.voxel_size, points.dtype)
    levels = [voxel_means(points, values, valid, size, capacity=config.max_points)]
    for i in range(1, config.levels):
        capacity = max(config.max_points >> i, 1)
        finer = levels[-1]
        levels.append(voxel_means(finer.points, finer.values, finer.valid, size * 2**i, capacity=capacity))
    return levels


def _fitting_size(
    points: Float[Array, "N 3"], valid: Bool[Array, " N"], config: PointsConfig
) -> Float[Array, ""]:
    """Share of the cloud's median radius, enlarged until the voxels fit and hold two points on average."""
    radius = masked_median(jnp.sqrt(jnp.sum(points**2, axis=1)), valid)
    start = jnp.where(radius > 0, radius * config.relative_voxel_size, 1)
    limit = jnp.minimum(config.max_points, jnp.sum(valid, dtype=jnp.int32) // 2)

    def crowded(size: Float[Array, ""]) -> Bool[Array, ""]:
        return (occupied_cells(points, valid, size) > limit) & (size < radius)

    return lax.stop_gradient(lax.while_loop(crowded, lambda size: size * 1.2, start))


def neighbour_level(means: VoxelMeans, k: int, config: PointsConfig) -> tuple[PointLevel, Int[Array, ""]]:
    """Level with the covariances of the k nearest neighbours, and the number of neighbours without a slot."""
    min_count = min(k, config.min_neighbours)
    found = neighbourhoods(
        means.points,
        means.valid,
        2 * means.size,
        k=k,
        min_count=min_count,
        slots=config.slots,
        doublings=config.doublings,
    )
    valid = means.valid & (found.counts >= min_count)
    return covariance_level(means, found.covariances.T, valid, "neighbours", config), found.dropped


def covariance_level(
    means: VoxelMeans,
    covariances: Symmetric,
    valid: Bool[Array, " M"],
    covariance: TargetCovariance,
    config: PointsConfig,
) -> PointLevel:
    """Level of given points and covariances; those on a line have no normal and are left out."""
    smallest, normals = smallest_eigenpair(covariances)
    xx, xy, xz, yy, yz, zz = covariances
    minors = xx * yy + xx * zz + yy * zz - xy * xy - xz * xz - yz * yz
    # The two larger eigenvalues by their sum and product: on a line the larger is many times the other.
    total = xx + yy + zz - smallest
    product = minors - smallest * total
    valid = valid & (product > config.min_flatness * total**2) & (total > 0)
    variance = masked_median(smallest, valid)
    deviation = jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1)), 0)
    matrices = from_upper_triangles(covariances)
    return _masked_level(means, normals.T, matrices, valid, deviation, covariance, config)


def point_level(means: VoxelMeans, config: PointsConfig) -> PointLevel:
    """Level of points alone, without normals."""
    normals, deviation = jnp.zeros_like(means.points), jnp.zeros_like(means.size)
    matrices = jnp.zeros((*normals.shape, 3), normals.dtype)
    return _masked_level(means, normals, matrices, means.valid, deviation, "isotropic", config)


def _masked_level(
    means: VoxelMeans,
    normals: Float[Array, "M 3"],
    covariances: Float[Array, "M 3 3"],
    valid: Bool[Array, " M"],
    deviation: Float[Array, ""],
    covariance: TargetCovariance,
    config: PointsConfig,
) -> PointLevel:
    """Level with normals and covariances of 0 where not valid, and the hash of its points."""
    return PointLevel(
        points=means.points,
        normals=jnp.where(valid[:, None], normals, 0),
        covariances=jnp.where(valid[:, None, None], covariances, 0),
        valid=valid,
        deviation=jnp.maximum(deviation, config.min_deviation * means.size),
        voxel_size=means.size,
        grid=build_hash(lax.stop_gradient(means.points), valid, means.size),
        covariance=covariance,
    )
