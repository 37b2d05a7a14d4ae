"""Models of what a camera does to its images: lens, exposure, distortion of depth, times of the rows.

Outlines in depth and edges in colour tell whether the two images belong together.
"""

from sfgs_jax.sensors._brightness import block_means as block_means
from sfgs_jax.sensors._brightness import brightness_change as brightness_change
from sfgs_jax.sensors._depth_correction import DEPTH_GRID as DEPTH_GRID
from sfgs_jax.sensors._depth_correction import DepthCorrection as DepthCorrection
from sfgs_jax.sensors._depth_correction import corrected_depth as corrected_depth
from sfgs_jax.sensors._depth_correction import grid_shares as grid_shares
from sfgs_jax.sensors._depth_correction import grid_values as grid_values
from sfgs_jax.sensors._depth_in_time import depth_in_time as depth_in_time
from sfgs_jax.sensors._depth_registration import depth_slopes as depth_slopes
from sfgs_jax.sensors._exposure import fitted_gain as fitted_gain
from sfgs_jax.sensors._exposure import with_gain as with_gain
from sfgs_jax.sensors._exposure_file import EXPOSURE_FILE as EXPOSURE_FILE
from sfgs_jax.sensors._exposure_file import format_gains as format_gains
from sfgs_jax.sensors._exposure_file import read_gains as read_gains
from sfgs_jax.sensors._frame_clock import FrameClock as FrameClock
from sfgs_jax.sensors._lens import undistorted as undistorted
from sfgs_jax.sensors._model import SensorModel as SensorModel
from sfgs_jax.sensors._outlines import Outlines as Outlines
from sfgs_jax.sensors._outlines import colour_edges as colour_edges
from sfgs_jax.sensors._outlines import depth_outlines as depth_outlines
from sfgs_jax.sensors._outlines import outline_agreement as outline_agreement
from sfgs_jax.sensors._sensor_file import SENSOR_FILE as SENSOR_FILE
from sfgs_jax.sensors._sensor_file import TIME_NAMES as TIME_NAMES
from sfgs_jax.sensors._sensor_file import read_sensors as read_sensors
from sfgs_jax.sensors._timing import RollingShutter as RollingShutter
from sfgs_jax.sensors._timing import SensorTiming as SensorTiming
from sfgs_jax.sensors._timing import carried as carried
from sfgs_jax.sensors._timing import row_places as row_places
from sfgs_jax.sensors._timing import turned as turned
from sfgs_jax.sensors._timing import velocities as velocities
from sfgs_jax.sensors._undistortion import Undistortion as Undistortion
