"""Unorganised clouds: points with their local planes at several voxel sizes."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.geometry import InputError
from sfgs_jax.gicp.config import PointsConfig, TargetCovariance
from sfgs_jax.gicp.neighbourhoods import neighbourhoods
from sfgs_jax.gicp.padding import padded
from sfgs_jax.gicp.sorting import masked_median
from sfgs_jax.gicp.spatial_hash import MAX_SLOTS, SpatialHash, build_hash
from sfgs_jax.gicp.symmetric import SQUARE, Symmetric, smallest_eigenpair
from sfgs_jax.gicp.voxels import VoxelMeans, occupied_cells, voxel_means


class PointLevel(eqx.Module):
    """One resolution of an unorganised cloud, in coordinates around the cloud's `origin`.

    Attributes:
        points: (M, 3) mean points of voxels, metres; 0 where not valid.
        normals: (M, 3) unit normals, of either sign; 0 where not valid.
        covariances: (M, 3, 3) of the neighbourhood, or of the Gaussian, square metres.
        valid: (M,) whether there is a point with a normal.
        deviation: standard deviation of a point's distance from its plane, metres: of the neighbourhoods'
            smallest eigenvalues the root of the median.
        voxel_size: metres.
        grid: hash of the points with cells of one voxel.
        covariance: what the level's points weigh a residual by, as a target; static.
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
        origin: (3,) what the levels' coordinates are relative to, metres.
        overflow: what was lost for want of room, over all levels: points beyond `PointsConfig.max_points`
            voxels or beyond the grid, and neighbours beyond `PointsConfig.slots` that a normal would have
            changed with. 0 if nothing was.
    """

    levels: tuple[PointLevel, ...]
    origin: Float[Array, "3"]
    overflow: Int[Array, ""]


def prepare_points(
    points: Float[Array | np.ndarray, "N 3"],
    *,
    valid: Bool[Array | np.ndarray, " N"] | None = None,
    k: int = 20,
    config: PointsConfig | None = None,
) -> PointCloud:
    """Cloud of unorganised points, ready to be source or target of `align`.

    Points are averaged over voxels, of 1, 2, 4 ... times the finest size, and each mean gets the covariance
    and the normal of its k nearest neighbours among the means. Points may be millimetres apart and kilometres
    from the origin, if they come as float64 NumPy arrays: they are centred before they become float32.

    Args:
        points: metres; rows that are not finite are left out.
        valid: which rows to use, all if not given.
        k: neighbours of a covariance, the point itself among them.
        config: capacities and sizes, `PointsConfig()` if not given.

    Raises:
        InputError: k or a setting is out of range.
    """
    config = PointsConfig() if config is None else config
    check(k, config)
    used, origin, centred = centre(points, valid)
    return _prepare_points(padded(centred), padded(used), origin, k, config)


def check(k: int, config: PointsConfig) -> None:
    """Refuse settings that no cloud can be prepared with."""
    if not 3 <= k <= config.slots:
        raise InputError(
            f"A plane needs 3 neighbours or more, and {config.slots} slots can't hold {k}: change k."
        )
    if config.slots > MAX_SLOTS or config.levels < 1 or config.max_points < 1:
        raise InputError(f"A point cloud needs at most {MAX_SLOTS} slots, and a level and a point at least.")
    if config.voxel_size is not None and not config.voxel_size > 0:
        raise InputError(f"A voxel size is positive, in metres, not {config.voxel_size}.")


def centre(
    points: Float[Array | np.ndarray, "N 3"], valid: Bool[Array | np.ndarray, " N"] | None
) -> tuple[Bool[Array, " N"], Float[Array, "3"], Float[Array, "N 3"]]:
    """Which points to use, their median as the origin, and the points relative to it.

    A float64 array of the host is centred there: float32 would round it to millimetres at ten kilometres.
    """
    given = jnp.ones(points.shape[0], bool) if valid is None else jnp.asarray(valid)
    if isinstance(points, np.ndarray):
        used = np.isfinite(points).all(axis=1) & np.asarray(given)
        middle = np.median(points[used], axis=0) if used.any() else np.zeros(3)
        origin = jnp.asarray(middle, jnp.asarray(points[:0]).dtype)
        centred = np.where(used[:, None], points - np.asarray(origin, points.dtype), 0)
        return jnp.asarray(used), origin, jnp.asarray(centred, origin.dtype)
    used = given & jnp.all(jnp.isfinite(points), axis=1)
    if points.shape[0] == 0:
        return used, jnp.zeros(3, points.dtype), points
    origin = jnp.stack([masked_median(c, used) for c in points.T])
    return used, origin, jnp.where(used[:, None], points - origin, 0)


@partial(jax.jit, static_argnames=("k", "config"))
def _prepare_points(
    points: Float[Array, "N 3"],
    valid: Bool[Array, " N"],
    origin: Float[Array, "3"],
    k: int,
    config: PointsConfig,
) -> PointCloud:
    nothing = jnp.zeros((points.shape[0], 0), points.dtype)
    levels, overflow = [], jnp.asarray(0, jnp.int32)
    for means in voxel_levels(points, nothing, valid, config):
        level, missed = plane_level(means, k, config)
        levels.append(level)
        overflow += missed + means.dropped
    return PointCloud(tuple(levels), origin, overflow)


def voxel_levels(
    points: Float[Array, "N 3"], values: Float[Array, "N C"], valid: Bool[Array, " N"], config: PointsConfig
) -> list[VoxelMeans]:
    """Means over voxels of the finest size, of twice that, and so on; half the capacity each."""
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
    """A share of the cloud's median radius, enlarged until the voxels fit and hold two points on average."""
    radius = masked_median(jnp.sqrt(jnp.sum(points**2, axis=1)), valid)
    start = jnp.where(radius > 0, radius * config.relative_voxel_size, 1)
    limit = jnp.minimum(config.max_points, jnp.sum(valid, dtype=jnp.int32) // 2)

    def crowded(size: Float[Array, ""]) -> Bool[Array, ""]:
        return (occupied_cells(points, valid, size) > limit) & (size < radius)

    return lax.stop_gradient(lax.while_loop(crowded, lambda size: size * 1.2, start))


def plane_level(means: VoxelMeans, k: int, config: PointsConfig) -> tuple[PointLevel, Int[Array, ""]]:
    """A level whose covariances are those of the k nearest neighbours, and the neighbours without a slot."""
    enough = min(k, config.min_neighbours)
    found = neighbourhoods(
        means.points,
        means.valid,
        2 * means.size,
        k=k,
        enough=enough,
        slots=config.slots,
        doublings=config.doublings,
    )
    valid = means.valid & (found.counts >= enough)
    return level_of(means, found.covariances.T, valid, "neighbours", config), found.missed


def level_of(
    means: VoxelMeans,
    covariances: Symmetric,
    valid: Bool[Array, " M"],
    covariance: TargetCovariance,
    config: PointsConfig,
) -> PointLevel:
    """A level of given points and covariances; those on a line, which have no normal, are left out."""
    smallest, normals = smallest_eigenpair(covariances)
    xx, xy, xz, yy, yz, zz = covariances
    second = xx * yy + xx * zz + yy * zz - xy * xy - xz * xz - yz * yz
    # The two larger eigenvalues by their sum and product: on a line the larger is many times the other.
    total = xx + yy + zz - smallest
    product = second - smallest * total
    valid = valid & (product > config.min_flatness * total**2) & (total > 0)
    variance = masked_median(smallest, valid)
    deviation = jnp.where(variance > 0, jnp.sqrt(jnp.where(variance > 0, variance, 1)), 0)
    matrices = covariances[SQUARE].transpose(2, 0, 1)
    return _level(means, normals.T, matrices, valid, deviation, covariance, config)


def point_level(means: VoxelMeans, config: PointsConfig) -> PointLevel:
    """A level of points alone, without normals."""
    nothing = jnp.zeros_like(means.points)
    matrices = jnp.zeros((*nothing.shape, 3), nothing.dtype)
    return _level(means, nothing, matrices, means.valid, jnp.zeros_like(means.size), "isotropic", config)


def _level(
    means: VoxelMeans,
    normals: Float[Array, "M 3"],
    covariances: Float[Array, "M 3 3"],
    valid: Bool[Array, " M"],
    deviation: Float[Array, ""],
    covariance: TargetCovariance,
    config: PointsConfig,
) -> PointLevel:
    return PointLevel(
        means.points,
        jnp.where(valid[:, None], normals, 0),
        jnp.where(valid[:, None, None], covariances, 0),
        valid,
        jnp.maximum(deviation, config.min_deviation * means.size),
        means.size,
        build_hash(lax.stop_gradient(means.points), valid, means.size),
        covariance,
    )
