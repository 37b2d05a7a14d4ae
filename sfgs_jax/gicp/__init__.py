"""Registration of depth images and point clouds."""

from sfgs_jax.gicp.align import align as align
from sfgs_jax.gicp.cloud import OrganisedCloud as OrganisedCloud
from sfgs_jax.gicp.cloud import OrganisedLevel as OrganisedLevel
from sfgs_jax.gicp.cloud import prepare as prepare
from sfgs_jax.gicp.config import GicpConfig as GicpConfig
from sfgs_jax.gicp.config import PointsConfig as PointsConfig
from sfgs_jax.gicp.files import load_points as load_points
from sfgs_jax.gicp.gaussian_target import prepare_gaussians as prepare_gaussians
from sfgs_jax.gicp.matches import RigidResult as RigidResult
from sfgs_jax.gicp.matches import rigid_from_matches as rigid_from_matches
from sfgs_jax.gicp.point_cloud import PointCloud as PointCloud
from sfgs_jax.gicp.point_cloud import PointLevel as PointLevel
from sfgs_jax.gicp.point_cloud import prepare_points as prepare_points
from sfgs_jax.gicp.prior import MotionPrior as MotionPrior
from sfgs_jax.gicp.result import RegistrationResult as RegistrationResult
