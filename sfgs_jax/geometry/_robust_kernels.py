"""Robust kernels of M-estimation, which bound the influence of residuals too large to be noise.

A kernel rho replaces the squared whitened residual s = r^T Omega r in the cost s / 2, with rho(s) ~ s for
small s. Its slope rho'(s) is the residual's weight in iteratively reweighted least squares.
A kernel begins to tell at a residual of `width` standard deviations; the smooth ones have begun by then.
"""

from typing import Literal, assert_never

import jax.numpy as jnp
from jaxtyping import Array, Float

from sfgs_jax.arrays import checked, require_above_zero

Kernel = Literal["none", "huber", "cauchy", "geman_mcclure", "tukey", "dynamic_covariance_scaling"]


@checked
def kernel_rho(square: Float[Array, "*n"], kernel: Kernel, width: float | Array) -> Float[Array, "*n"]:
    """Robust replacement rho(s) of squared whitened residuals s; continuous slope, rho(0) = 0.

    Source: Zhang, Parameter estimation techniques (1997), table 1, for Huber, Cauchy, Geman-McClure and
    Tukey; Agarwal et al., Robust map optimization using dynamic covariance scaling (ICRA 2013), eq. 14,
    whose Phi is `width` squared, integrated from its weight.

    Args:
        square: squared whitened residuals, at least 0.
        kernel: which kernel.
        width: positive, in standard deviations.

    Raises:
        InputError: the width is not positive.
    """
    require_above_zero(width, "width of kernel_rho")
    limit = jnp.asarray(width, square.dtype) ** 2
    match kernel:
        case "none":
            return square
        case "huber":
            large = square > limit
            root = jnp.sqrt(jnp.where(large, square, 1))
            return jnp.where(large, 2 * jnp.sqrt(limit) * root - limit, square)
        case "cauchy":
            return limit * jnp.log1p(square / limit)
        case "geman_mcclure":
            return square * limit / (limit + square)
        case "tukey":
            rest = jnp.maximum(1 - square / limit, 0)
            return limit / 3 * (1 - rest**3)
        case "dynamic_covariance_scaling":
            beyond = limit * (3 * square - limit) / (limit + square)
            return jnp.where(square > limit, beyond, square)
        case _:
            assert_never(kernel)


@checked
def kernel_weight(square: Float[Array, "*n"], kernel: Kernel, width: float | Array) -> Float[Array, "*n"]:
    """Weight rho'(s) of squared whitened residuals s, from 1 at s = 0 down; arguments of `kernel_rho`."""
    require_above_zero(width, "width of kernel_weight")
    limit = jnp.asarray(width, square.dtype) ** 2
    match kernel:
        case "none":
            return jnp.ones_like(square)
        case "huber":
            large = square > limit
            return jnp.where(large, jnp.sqrt(limit / jnp.where(large, square, 1)), 1)
        case "cauchy":
            return limit / (limit + square)
        case "geman_mcclure":
            return (limit / (limit + square)) ** 2
        case "tukey":
            return jnp.maximum(1 - square / limit, 0) ** 2
        case "dynamic_covariance_scaling":
            return jnp.minimum(2 * limit / (limit + square), 1) ** 2
        case _:
            assert_never(kernel)
