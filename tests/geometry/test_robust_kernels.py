"""Robust kernels: their slope, their limits, and gradients that stay finite."""

from typing import get_args

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import geometry
from sfgs_jax.geometry import Kernel

# One program for each kernel instead of one for each operation.
kernel_rho, kernel_weight = (
    jax.jit(function, static_argnums=1) for function in (geometry.kernel_rho, geometry.kernel_weight)
)
KERNELS = get_args(Kernel)


@pytest.mark.parametrize("kernel", KERNELS)
def test_the_weight_is_the_slope_of_rho(float64, kernel):
    squares = jnp.asarray([0.0, 1e-6, 0.3, 3.9, 4.1, 30.0, 1e4])
    slopes = jax.vmap(jax.grad(lambda s: kernel_rho(s, kernel, 2.0)))(squares)
    np.testing.assert_allclose(kernel_weight(squares, kernel, 2.0), slopes, rtol=1e-10, atol=1e-15)


@pytest.mark.parametrize("kernel", KERNELS)
def test_small_residuals_count_in_full_and_larger_ones_never_more(kernel):
    squares = jnp.linspace(0, 100, 1001)
    weights = kernel_weight(squares, kernel, 1.5)
    assert weights[0] == 1
    assert kernel_rho(squares, kernel, 1.5)[0] == 0
    assert np.all(np.diff(weights) <= 1e-7)
    assert np.all(weights >= 0)
    np.testing.assert_allclose(kernel_rho(jnp.asarray([1e-4]), kernel, 1.5), 1e-4, rtol=1e-3)


@pytest.mark.parametrize("kernel", KERNELS)
def test_rho_is_continuous_at_the_width(float64, kernel):
    below, above = kernel_rho(jnp.asarray([4 - 1e-9, 4 + 1e-9]), kernel, 2.0)
    assert abs(above - below) < 1e-8


@pytest.mark.parametrize(
    ("kernel", "rho", "weight"),
    [
        ("huber", 2 * 2 * 6 - 4, 1 / 3),
        ("cauchy", 4 * np.log(10), 1 / 10),
        ("geman_mcclure", 3.6, 1 / 100),
        ("tukey", 4 / 3, 0),
        ("dynamic_covariance_scaling", 4 * (108 - 4) / 40, (8 / 40) ** 2),
    ],
)
def test_values_worked_out_by_hand(kernel, rho, weight):
    """A residual of 6 with a width of 2."""
    np.testing.assert_allclose(kernel_rho(jnp.asarray(36.0), kernel, 2.0), rho, rtol=1e-6)
    np.testing.assert_allclose(kernel_weight(jnp.asarray(36.0), kernel, 2.0), weight, rtol=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("function", [kernel_rho, kernel_weight])
def test_gradients_are_finite_everywhere(kernel, function):
    for square in (0.0, 1e-30, 2.25, 1e12):
        gradients = jax.grad(function, argnums=(0, 2))(np.float32(square), kernel, np.float32(1.5))
        assert np.all(np.isfinite(gradients))
