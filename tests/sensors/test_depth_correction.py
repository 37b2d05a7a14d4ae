"""Correction of a smooth error of inverse depth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from sfgs_jax import sensors
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, corrected_depth

# One program instead of one for each operation.
corrected = jax.jit(DepthCorrection.corrected)
image_of = jax.jit(DepthCorrection.image)
offsets_at = jax.jit(DepthCorrection.at)
grid_shares = jax.jit(sensors.grid_shares)
grid_values = jax.jit(sensors.grid_values)

CAMERA = Camera(130.0, 130.0, 79.5, 59.5, width=160, height=120)


@pytest.fixture
def correction(rng):
    return DepthCorrection(jnp.asarray(rng.normal(0, 0.005, DEPTH_GRID), jnp.float32))


@pytest.fixture
def depth(rng):
    return jnp.asarray(rng.uniform(0.5, 5, CAMERA.shape), jnp.float32)


def test_zeros_change_nothing(depth):
    smooth = jnp.asarray(np.sort(np.asarray(depth), axis=None).reshape(depth.shape))
    for image in (depth, smooth):
        same = corrected(DepthCorrection(jnp.zeros(DEPTH_GRID)), image, CAMERA)
        np.testing.assert_array_equal(same, image)
        same = corrected(DepthCorrection(jnp.zeros(DEPTH_GRID), jnp.zeros(6)), image, CAMERA)
        np.testing.assert_allclose(same, image, rtol=1e-6)


def test_a_distortion_of_the_same_offsets_is_undone(correction, depth):
    offsets = np.asarray(image_of(correction, CAMERA))
    measured = 1 / (1 / np.asarray(depth) + offsets)
    assert np.abs(measured - depth).max() > 0.1
    np.testing.assert_allclose(corrected(correction, jnp.asarray(measured), CAMERA), depth, rtol=2e-6)


def test_missing_depth_stays_missing_and_nothing_lies_behind_infinity():
    offset = jnp.full((1, 4), 0.5)
    depth = jnp.asarray([[0.0, jnp.nan, 1.0, 2.5]])
    correction = DepthCorrection(jnp.full((2, 2), 0.5))
    camera = Camera(4.0, 4.0, 1.5, 0.0, width=4, height=1)
    np.testing.assert_allclose(corrected(correction, depth, camera), [[0, 0, 2, 0]])
    slope = jax.jit(jax.grad(lambda c: jnp.sum(corrected_depth(jnp.nan_to_num(depth), c))))
    gradient = slope(offset)
    assert np.isfinite(gradient).all()


def test_offsets_at_pixels_are_those_of_the_image(correction):
    pixels = CAMERA.pixels().reshape(-1, 2)
    image = np.asarray(image_of(correction, CAMERA)).ravel()
    np.testing.assert_allclose(offsets_at(correction, pixels, CAMERA), image, atol=1e-8)
    shares = grid_shares(pixels, CAMERA)
    np.testing.assert_allclose(np.asarray(shares).sum(0), 1, atol=1e-6)
    np.testing.assert_allclose(np.asarray(correction.offsets).ravel() @ np.asarray(shares), image, atol=1e-8)


def test_each_pixel_gets_the_value_of_the_grid_that_it_asks(rng):
    grids = jnp.asarray(rng.normal(size=(3, *DEPTH_GRID)), jnp.float32)
    pixels = jnp.asarray(rng.uniform(-20, 180, (400, 2)), jnp.float32)
    numbers = rng.integers(0, 3, 400)
    shares = np.asarray(grid_shares(pixels, CAMERA))
    by_shares = np.einsum("ng,gn->n", np.asarray(grids).reshape(3, -1)[numbers], shares)
    found = grid_values(grids, jnp.asarray(numbers), pixels, CAMERA)
    np.testing.assert_allclose(found, by_shares, atol=2e-6)


def test_the_offsets_are_the_same_at_every_resolution(correction):
    whole = np.asarray(image_of(correction, CAMERA)).reshape(60, 2, 80, 2).mean((1, 3))
    half = np.asarray(image_of(correction, CAMERA.downscaled(2)))
    # Only pixels over a node differ.
    np.testing.assert_allclose(half, whole, atol=4e-4)
    assert np.median(np.abs(half - whole)) < 1e-7


def test_gradients_reach_the_offsets(correction, depth):
    weights = jnp.cos(jnp.arange(depth.size, dtype=depth.dtype)).reshape(depth.shape)

    @jax.jit
    def total(offsets):
        return jnp.sum(weights * DepthCorrection(jnp.asarray(offsets)).corrected(depth, CAMERA))

    check_grads(total, (correction.offsets,), order=1, modes=("rev",), atol=0.1, rtol=0.02)


@pytest.mark.parametrize("extrinsic", [None, jnp.arange(6, dtype=jnp.float32)])
def test_on_the_host_the_parameters_are_the_same(correction, extrinsic):
    correction = DepthCorrection(correction.offsets, extrinsic)
    np.testing.assert_array_equal(correction.on_host(), correction.vector)
