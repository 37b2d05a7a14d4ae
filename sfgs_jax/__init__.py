"""sfgs_jax: differentiable RGB-D SLAM with Gaussian-splat maps, in JAX."""

from sfgs_jax.geometry import Camera as Camera
from sfgs_jax.geometry import Frame as Frame

__version__ = "0.1.0"
