"""Differentiable Gaussian splatting: rendering with gradients to every input, image losses, files."""

from sfgs_jax.splatting import reference as reference
from sfgs_jax.splatting._binning import TileLists as TileLists
from sfgs_jax.splatting._binning import bin_into_tiles as bin_into_tiles
from sfgs_jax.splatting._capacity import pair_capacity as pair_capacity
from sfgs_jax.splatting._compositing import composite as composite
from sfgs_jax.splatting._config import RenderConfig as RenderConfig
from sfgs_jax.splatting._gaussians import GAUSSIAN_PARAMETERS as GAUSSIAN_PARAMETERS
from sfgs_jax.splatting._gaussians import Gaussians as Gaussians
from sfgs_jax.splatting._losses import l1 as l1
from sfgs_jax.splatting._losses import ssim as ssim
from sfgs_jax.splatting._projection import Projected as Projected
from sfgs_jax.splatting._projection import project as project
from sfgs_jax.splatting._rasterization import Raster as Raster
from sfgs_jax.splatting._rasterization import rasterize as rasterize
from sfgs_jax.splatting._rendering import RenderOutput as RenderOutput
from sfgs_jax.splatting._rendering import render as render
from sfgs_jax.splatting._sorting import sort_by_tile_and_depth as sort_by_tile_and_depth
from sfgs_jax.splatting._spherical_harmonics import rgb_to_sh as rgb_to_sh
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb as sh_to_rgb
from sfgs_jax.splatting.files import load_ply as load_ply
from sfgs_jax.splatting.files import load_splat as load_splat
from sfgs_jax.splatting.files import map_file as map_file
from sfgs_jax.splatting.files import save_ply as save_ply
from sfgs_jax.splatting.files import save_points as save_points
from sfgs_jax.splatting.files import save_splat as save_splat
