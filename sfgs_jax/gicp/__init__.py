"""Registration of depth images, point clouds and Gaussian maps, and of matched points."""

from sfgs_jax.gicp import clouds as clouds
from sfgs_jax.gicp import matched_points as matched_points
from sfgs_jax.gicp._align import align as align
from sfgs_jax.gicp._assessment import RegistrationResult as RegistrationResult
from sfgs_jax.gicp._config import GicpConfig as GicpConfig
from sfgs_jax.gicp._config import PointsConfig as PointsConfig
from sfgs_jax.gicp._correspondences import Correspondences as Correspondences
from sfgs_jax.gicp._correspondences import SourcePoints as SourcePoints
from sfgs_jax.gicp._correspondences import TargetSurface as TargetSurface
from sfgs_jax.gicp._correspondences import associate as associate
from sfgs_jax.gicp._level_problem import LevelProblem as LevelProblem
from sfgs_jax.gicp._level_problem import level_problem as level_problem
from sfgs_jax.gicp._normal_equations import MotionPrior as MotionPrior
from sfgs_jax.gicp._normal_equations import NormalEquations as NormalEquations
from sfgs_jax.gicp._normal_equations import weight_matrices as weight_matrices
from sfgs_jax.gicp._point_files import load_points as load_points
from sfgs_jax.gicp.clouds import OrganisedCloud as OrganisedCloud
from sfgs_jax.gicp.clouds import OrganisedLevel as OrganisedLevel
from sfgs_jax.gicp.clouds import PointCloud as PointCloud
from sfgs_jax.gicp.clouds import PointLevel as PointLevel
from sfgs_jax.gicp.clouds import prepare as prepare
from sfgs_jax.gicp.clouds import prepare_gaussians as prepare_gaussians
from sfgs_jax.gicp.clouds import prepare_points as prepare_points
from sfgs_jax.gicp.matched_points import RigidResult as RigidResult
from sfgs_jax.gicp.matched_points import rigid_from_matches as rigid_from_matches
