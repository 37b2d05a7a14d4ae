"""Readers of recordings on disk, one module a layout.

Each module has two functions. The first, `matches(source)`, tells whether a path has the layout. The
second, `read(source, options)`, opens it as a `FileRecording`, with the errors of `open_recording`.
"""

from sfgs_jax.datasets.layouts import colmap as colmap
from sfgs_jax.datasets.layouts import euroc as euroc
from sfgs_jax.datasets.layouts import folder as folder
from sfgs_jax.datasets.layouts import icl_nuim as icl_nuim
from sfgs_jax.datasets.layouts import nerfstudio as nerfstudio
from sfgs_jax.datasets.layouts import open3d as open3d
from sfgs_jax.datasets.layouts import record3d as record3d
from sfgs_jax.datasets.layouts import replica as replica
from sfgs_jax.datasets.layouts import rosbag as rosbag
from sfgs_jax.datasets.layouts import scannet as scannet
from sfgs_jax.datasets.layouts import scannetpp as scannetpp
from sfgs_jax.datasets.layouts import seven_scenes as seven_scenes
from sfgs_jax.datasets.layouts import stray as stray
from sfgs_jax.datasets.layouts import tum as tum
from sfgs_jax.datasets.layouts import video as video
