"""Differentiable Gaussian splatting: rendering with gradients to everything, image losses, PLY files."""

from sfgs_jax.splatting.losses import l1 as l1
from sfgs_jax.splatting.losses import ssim as ssim
