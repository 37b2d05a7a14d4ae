"""Built-in synthetic recordings: textured places, ray-cast with exact depth and poses.

`SyntheticRecording` is the recording. The rest are its parts: scenes and their builder, places with a
camera's way through them, the renderers, and the sensor's faults and noise.
"""

from sfgs_jax.datasets.synthetic._furnished_room import ROOM_SIZE as ROOM_SIZE
from sfgs_jax.datasets.synthetic._furnished_room import furnished_room as furnished_room
from sfgs_jax.datasets.synthetic._kinect_faults import KINECT_V1 as KINECT_V1
from sfgs_jax.datasets.synthetic._kinect_faults import KinectFaults as KinectFaults
from sfgs_jax.datasets.synthetic._kinect_faults import row_delays as row_delays
from sfgs_jax.datasets.synthetic._noise import add_noise as add_noise
from sfgs_jax.datasets.synthetic._path import along as along
from sfgs_jax.datasets.synthetic._path import closed_path as closed_path
from sfgs_jax.datasets.synthetic._path import looking as looking
from sfgs_jax.datasets.synthetic._path import poses_between as poses_between
from sfgs_jax.datasets.synthetic._places import PLACES as PLACES
from sfgs_jax.datasets.synthetic._places import Place as Place
from sfgs_jax.datasets.synthetic._raycast import Hits as Hits
from sfgs_jax.datasets.synthetic._raycast import cast as cast
from sfgs_jax.datasets.synthetic._raycast import cast_rows as cast_rows
from sfgs_jax.datasets.synthetic._recording import SyntheticRecording as SyntheticRecording
from sfgs_jax.datasets.synthetic._render import IdealView as IdealView
from sfgs_jax.datasets.synthetic._render import render_view as render_view
from sfgs_jax.datasets.synthetic._rolling_shutter import colour_by_rows as colour_by_rows
from sfgs_jax.datasets.synthetic._rolling_shutter import depth_by_rows as depth_by_rows
from sfgs_jax.datasets.synthetic._scene import Scene as Scene
from sfgs_jax.datasets.synthetic._scene import SceneBuilder as SceneBuilder
from sfgs_jax.datasets.synthetic._textures import Materials as Materials
from sfgs_jax.datasets.synthetic._textures import Waves as Waves
from sfgs_jax.datasets.synthetic._textures import cosine_of_periods as cosine_of_periods
from sfgs_jax.datasets.synthetic._textures import random_waves as random_waves
from sfgs_jax.datasets.synthetic._textures import surface_colours as surface_colours
