"""Transforms, surfaces and their derivatives stay exact where products run at TF32, 11 bits, by default."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tf32 import at_tf32, default_products

from sfgs_jax.geometry import (
    Camera,
    downscale_depth,
    downscale_rgb,
    inverse_right_jacobian,
    register_depth,
    se3,
    surface,
)

CAMERA = Camera(60.0, 55.0, 23.5, 17.75, width=48, height=36)
T = se3.exp(jnp.asarray([0.3, -1.2, 0.7, 0.4, -0.9, 1.3]))
DEPTH = (2 + 0.1 * np.sin(np.arange(36)[:, None] / 7) + 0.01 * np.arange(48)).astype(np.float32)
POINTS = np.random.default_rng(0).uniform(-5, 5, (100, 3)).astype(np.float32)

CASES = {
    "transform": lambda T: se3.transform(T, jnp.asarray(POINTS)),
    "compose": lambda T: se3.compose(T, se3.inverse(se3.compose(T, T))).wxyz_xyz,
    "exp": lambda T: se3.exp(se3.log(T) / 2).wxyz_xyz,
    "log": lambda T: se3.log(T),
    "extent": lambda T: jnp.stack(se3.extent(T)),
    "adjoint": lambda T: se3.adjoint(T),
    "matrix": lambda T: se3.matrix(T),
    "quaternion_product": lambda T: se3.quaternion_product(T.wxyz_xyz[:4], T.wxyz_xyz[1:5]),
    "inverse_right_jacobian": lambda T: inverse_right_jacobian(se3.log(T)[:, None]),
    "slope_of_transform": jax.jacobian(
        lambda T: se3.transform(se3.compose(T, se3.exp(se3.log(T))), jnp.asarray(POINTS[:5]))
    ),
    "register_depth": lambda T: register_depth(
        jnp.asarray(DEPTH), CAMERA, CAMERA, se3.exp(0.01 * se3.log(T))
    ),
    "downscale_depth": lambda T: downscale_depth(jnp.asarray(DEPTH) * T.wxyz_xyz[0], 2),
    "downscale_rgb": lambda T: downscale_rgb(jnp.asarray(POINTS).reshape(10, 10, 3) * T.wxyz_xyz[0], 2),
    "surface": lambda T: jax.tree.leaves(surface(jnp.asarray(DEPTH) * T.wxyz_xyz[0], CAMERA))[:3],
    "slope_of_surface": jax.grad(
        lambda T: jnp.sum(surface(jnp.asarray(DEPTH) * T.wxyz_xyz[0], CAMERA).covariances)
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_no_product_runs_at_the_default_precision(name):
    assert default_products(CASES[name], T) == []


def test_rounded_products_would_be_noticed():
    exact = CASES["transform"](T)
    np.testing.assert_array_equal(at_tf32(CASES["transform"])(T), jax.jit(CASES["transform"])(T))
    rounded = at_tf32(CASES["transform"], every=True)(T)
    assert 1e-4 < np.abs(rounded - exact).max() < 1e-2
