"""Maps and paths in the browser, on viser."""

from sfgs_jax.viewer.scene import MapScene as MapScene
from sfgs_jax.viewer.splats import Splats as Splats
from sfgs_jax.viewer.splats import splats_of as splats_of
from sfgs_jax.viewer.view import view_run as view_run
