"""A map of Gaussians as a cloud to align with."""

from functools import partial
from typing import assert_never

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import InputError, checked, padded, upper_triangles
from sfgs_jax.gicp._config import PointsConfig, TargetCovariance
from sfgs_jax.gicp.clouds._point_cloud import (
    PointCloud,
    centre,
    check_neighbours,
    covariance_level,
    neighbour_level,
    point_level,
    voxel_levels,
)


@checked
def prepare_gaussians(
    means: Float[Array | np.ndarray, "N 3"],
    covariances: Float[Array | np.ndarray, "K 3 3"],
    *,
    valid: Bool[Array | np.ndarray, " N"] | None = None,
    target_covariance: TargetCovariance = "neighbours",
    k: int = 20,
    config: PointsConfig | None = None,
) -> PointCloud:
    """Cloud of a Gaussian map, ready to be target of `align` (with `neighbours` also its source).

    Means and covariances are averaged over voxels. A residual is weighted by one of three covariances.

    - `isotropic`: the same in every direction. Only the source's normals count (point to plane).
    - `map`: the shape of the Gaussian's own covariance. Its size does not matter.
    - `neighbours`: a plane through the k nearest means, like in `prepare_points`.

    Args:
        means: metres; rows that are not finite are left out.
        covariances: square metres, symmetric; rows that are not finite are left out.
        valid: Gaussians to use, all if not given.
        target_covariance: see above; static.
        k: neighbours of a covariance, the mean itself among them; static.
        config: capacities and sizes, `PointsConfig()` if not given.

    Raises:
        InputError: there is not one covariance for each mean, or k is out of range.
    """
    config = PointsConfig() if config is None else config
    check_neighbours(k, config)
    if means.shape[0] != covariances.shape[0]:
        raise InputError(
            f"There are {means.shape[0]} means but {covariances.shape[0]} covariances; give one for each."
        )
    used, origin, centred = centre(means, valid)
    return _prepare_gaussians(centred, padded(covariances), used, origin, target_covariance, k, config)


@partial(jax.jit, static_argnames=("target_covariance", "k", "config"))
def _prepare_gaussians(
    means: Float[Array, "N 3"],
    matrices: Float[Array | np.ndarray, "N 3 3"],
    valid: Bool[Array, " N"],
    origin: Float[Array, "3"],
    target_covariance: TargetCovariance,
    k: int,
    config: PointsConfig,
) -> PointCloud:
    levels, overflow = [], jnp.asarray(0, jnp.int32)
    matrices = jnp.asarray(matrices)
    valid = valid & jnp.all(jnp.isfinite(matrices), axis=(1, 2))
    triangles = jnp.where(valid[:, None], upper_triangles(matrices).T, 0)
    for cells in voxel_levels(means, triangles, valid, config):
        match target_covariance:
            case "neighbours":
                level, dropped = neighbour_level(cells, k, config)
            case "map":
                level, dropped = covariance_level(cells, cells.values.T, cells.valid, "map", config), 0
            case "isotropic":
                level, dropped = point_level(cells, config), 0
            case _:
                assert_never(target_covariance)
        levels.append(level)
        overflow += dropped + cells.dropped
    return PointCloud(tuple(levels), origin, overflow)
