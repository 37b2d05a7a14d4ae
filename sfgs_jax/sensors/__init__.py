"""Models of what a camera does to its images: the lens, and the times of the rows."""

from sfgs_jax.sensors._lens import Undistortion as Undistortion
from sfgs_jax.sensors._timing import SensorTiming as SensorTiming
from sfgs_jax.sensors._timing import carried as carried
from sfgs_jax.sensors._timing import row_places as row_places
from sfgs_jax.sensors._timing import turned as turned
from sfgs_jax.sensors._timing import velocities as velocities
