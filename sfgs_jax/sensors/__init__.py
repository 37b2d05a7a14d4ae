"""Models of what a camera does to its images: the lens."""

from sfgs_jax.sensors._lens import Undistortion as Undistortion
