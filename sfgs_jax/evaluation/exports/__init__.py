"""Runs for other programs: poses, images and the map, in the layouts that those programs read.

The world is the run's own: the axes of its first camera, in metres.
"""

from sfgs_jax.evaluation.exports._colmap import write_colmap as write_colmap
from sfgs_jax.evaluation.exports._nerfstudio import write_nerfstudio as write_nerfstudio
from sfgs_jax.evaluation.exports._rerun import write_rerun as write_rerun
