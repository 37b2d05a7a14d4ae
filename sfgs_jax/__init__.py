"""sfgs_jax: differentiable RGB-D SLAM with Gaussian-splat maps, in JAX.

`sfgs_jax.evaluation` and `sfgs_jax.viewer` are imported by name where they are needed: they bring in
plotting and a web server.
"""

from sfgs_jax import datasets as datasets
from sfgs_jax import factor_graph as factor_graph
from sfgs_jax import geometry as geometry
from sfgs_jax import gicp as gicp
from sfgs_jax import slam as slam
from sfgs_jax import splatting as splatting
from sfgs_jax import superfeats as superfeats
from sfgs_jax.geometry import Camera as Camera
from sfgs_jax.geometry import Frame as Frame

__version__ = "0.1.0"
