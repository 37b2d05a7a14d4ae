"""Maps and paths in the browser, on viser.

The function `view_run` shows the folder of a run or a file of Gaussians, `view_model` a mesh or points, and
`LiveView` a run while it goes on. The class `MapScene` shows any map and path in any viser server.
"""

from sfgs_jax.viewer._cropping import Box as Box
from sfgs_jax.viewer._finished_run import RecordedFrames as RecordedFrames
from sfgs_jax.viewer._levelling import Level as Level
from sfgs_jax.viewer._levelling import find_level as find_level
from sfgs_jax.viewer._live_view import LiveView as LiveView
from sfgs_jax.viewer._model_scene import ModelScene as ModelScene
from sfgs_jax.viewer._model_scene import view_model as view_model
from sfgs_jax.viewer._run_control import RunControl as RunControl
from sfgs_jax.viewer._scene import MapScene as MapScene
from sfgs_jax.viewer._splats import Splats as Splats
from sfgs_jax.viewer._splats import splats_of as splats_of
from sfgs_jax.viewer._view import view_run as view_run
