"""Cameras, frames, poses: what every other room builds on."""

from sfgs_jax.geometry import se3 as se3
from sfgs_jax.geometry.camera import Camera as Camera
from sfgs_jax.geometry.downscale import downscale_depth as downscale_depth
from sfgs_jax.geometry.downscale import downscale_rgb as downscale_rgb
from sfgs_jax.geometry.errors import FrameError as FrameError
from sfgs_jax.geometry.errors import InputError as InputError
from sfgs_jax.geometry.files import write_atomically as write_atomically
from sfgs_jax.geometry.frame import Frame as Frame
from sfgs_jax.geometry.frame import clean_depth as clean_depth
from sfgs_jax.geometry.registration import register_depth as register_depth
from sfgs_jax.geometry.robust_kernels import Kernel as Kernel
from sfgs_jax.geometry.robust_kernels import kernel_rho as kernel_rho
from sfgs_jax.geometry.robust_kernels import kernel_weight as kernel_weight
from sfgs_jax.geometry.rotations import quaternions_from_rotations as quaternions_from_rotations
from sfgs_jax.geometry.rotations import rotations_from_quaternions as rotations_from_quaternions
from sfgs_jax.geometry.surface import Surface as Surface
from sfgs_jax.geometry.surface import surface as surface
from sfgs_jax.geometry.trajectory import Trajectory as Trajectory
from sfgs_jax.geometry.trajectory import format_tum as format_tum
from sfgs_jax.geometry.trajectory import parse_tum as parse_tum
from sfgs_jax.geometry.trajectory import read_tum as read_tum
