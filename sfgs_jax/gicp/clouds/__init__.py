"""Clouds that GICP registers, from depth images, points and Gaussians, and their searches."""

from sfgs_jax.gicp.clouds._depth_cloud import OrganisedCloud as OrganisedCloud
from sfgs_jax.gicp.clouds._depth_cloud import OrganisedLevel as OrganisedLevel
from sfgs_jax.gicp.clouds._depth_cloud import prepare as prepare
from sfgs_jax.gicp.clouds._gaussian_cloud import prepare_gaussians as prepare_gaussians
from sfgs_jax.gicp.clouds._neighbours import Neighbourhoods as Neighbourhoods
from sfgs_jax.gicp.clouds._neighbours import neighbourhoods as neighbourhoods
from sfgs_jax.gicp.clouds._point_cloud import PointCloud as PointCloud
from sfgs_jax.gicp.clouds._point_cloud import PointLevel as PointLevel
from sfgs_jax.gicp.clouds._point_cloud import prepare_points as prepare_points
from sfgs_jax.gicp.clouds._spatial_hash import Runs as Runs
from sfgs_jax.gicp.clouds._spatial_hash import SpatialHash as SpatialHash
from sfgs_jax.gicp.clouds._spatial_hash import build_hash as build_hash
from sfgs_jax.gicp.clouds._spatial_hash import nearest as nearest
from sfgs_jax.gicp.clouds._spatial_hash import neighbouring_runs as neighbouring_runs
from sfgs_jax.gicp.clouds._voxels import VoxelMeans as VoxelMeans
from sfgs_jax.gicp.clouds._voxels import occupied_cells as occupied_cells
from sfgs_jax.gicp.clouds._voxels import voxel_means as voxel_means
