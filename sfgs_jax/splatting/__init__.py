"""Differentiable Gaussian splatting: rendering with gradients to everything, image losses, files."""

from sfgs_jax.splatting import reference as reference
from sfgs_jax.splatting.capacity import pair_capacity as pair_capacity
from sfgs_jax.splatting.config import RenderConfig as RenderConfig
from sfgs_jax.splatting.gaussians import Gaussians as Gaussians
from sfgs_jax.splatting.harmonics import rgb_to_sh as rgb_to_sh
from sfgs_jax.splatting.harmonics import sh_to_rgb as sh_to_rgb
from sfgs_jax.splatting.losses import l1 as l1
from sfgs_jax.splatting.losses import ssim as ssim
from sfgs_jax.splatting.ply import load_ply as load_ply
from sfgs_jax.splatting.ply import save_ply as save_ply
from sfgs_jax.splatting.projection import Projected as Projected
from sfgs_jax.splatting.projection import project as project
from sfgs_jax.splatting.rasterization import Raster as Raster
from sfgs_jax.splatting.rasterization import rasterize as rasterize
from sfgs_jax.splatting.rendering import RenderOutput as RenderOutput
from sfgs_jax.splatting.rendering import render as render
from sfgs_jax.splatting.splat import save_splat as save_splat
