"""Cameras, frames, poses, surfaces and robust kernels, which every other room builds on."""

from sfgs_jax.geometry import se3 as se3
from sfgs_jax.geometry._camera import Camera as Camera
from sfgs_jax.geometry._depth_registration import register_depth as register_depth
from sfgs_jax.geometry._downscale import downscale_depth as downscale_depth
from sfgs_jax.geometry._downscale import downscale_rgb as downscale_rgb
from sfgs_jax.geometry._frame import Frame as Frame
from sfgs_jax.geometry._frame import clean_depth as clean_depth
from sfgs_jax.geometry._reprojection import NEAREST_DEPTH as NEAREST_DEPTH
from sfgs_jax.geometry._reprojection import ReprojectionResiduals as ReprojectionResiduals
from sfgs_jax.geometry._reprojection import reprojection_residuals as reprojection_residuals
from sfgs_jax.geometry._robust_kernels import Kernel as Kernel
from sfgs_jax.geometry._robust_kernels import kernel_rho as kernel_rho
from sfgs_jax.geometry._robust_kernels import kernel_weight as kernel_weight
from sfgs_jax.geometry._rotations import quaternions_from_rotations as quaternions_from_rotations
from sfgs_jax.geometry._rotations import rotation_vectors as rotation_vectors
from sfgs_jax.geometry._rotations import rotations_from_quaternions as rotations_from_quaternions
from sfgs_jax.geometry._rotations import slerp as slerp
from sfgs_jax.geometry._surface import Surface as Surface
from sfgs_jax.geometry._surface import surface as surface
from sfgs_jax.geometry._tangents import inverse_right_jacobian as inverse_right_jacobian
from sfgs_jax.geometry._tangents import skew as skew
from sfgs_jax.geometry._trajectory import Trajectory as Trajectory
from sfgs_jax.geometry._trajectory import format_tum as format_tum
from sfgs_jax.geometry._trajectory import parse_tum as parse_tum
from sfgs_jax.geometry._trajectory import read_tum as read_tum
