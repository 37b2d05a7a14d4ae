"""sfgs_jax: differentiable RGB-D SLAM with Gaussian-splat maps, in JAX.

`sfgs_jax.evaluation` and `sfgs_jax.viewer` are imported by name where they are needed: they bring in
plotting and a web server.
"""

import os as _os

# jaxlib 0.9.1 to 0.10.1 log an error of 3 KB for each program loaded from the compilation cache, although the
# program is right (jax#38445). The level is read when jaxlib is first imported.
_os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

from sfgs_jax import datasets as datasets
from sfgs_jax import factor_graph as factor_graph
from sfgs_jax import geometry as geometry
from sfgs_jax import gicp as gicp
from sfgs_jax import slam as slam
from sfgs_jax import splatting as splatting
from sfgs_jax import superfeats as superfeats
from sfgs_jax.arrays import enable_cache as enable_cache
from sfgs_jax.geometry import Camera as Camera
from sfgs_jax.geometry import Frame as Frame

__version__ = "0.1.0"
