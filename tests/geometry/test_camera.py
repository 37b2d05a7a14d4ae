"""The conventions: axes, pixel centres, scaling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Camera
from sfgs_jax.arrays import InputError


@pytest.fixture
def camera() -> Camera:
    return Camera(50.0, 60.0, 15.5, 11.0, width=32, height=24)


def test_axes_are_x_right_y_down_z_forward(camera):
    pixels = camera.project(jnp.asarray([[0.1, 0.0, 1.0], [0.0, 0.1, 1.0], [0.0, 0.0, 1.0]]))
    np.testing.assert_allclose(pixels, [[20.5, 11.0], [15.5, 17.0], [15.5, 11.0]], rtol=1e-6)


def test_pixel_centres_are_integers(camera):
    pixels = camera.pixels()
    assert pixels.shape == (24, 32, 2)
    np.testing.assert_array_equal(pixels[7, 3], [3.0, 7.0])


def test_unproject_inverts_project(camera, rng):
    depth = jnp.asarray(rng.uniform(0.5, 5, camera.shape), jnp.float32)
    pixels = camera.pixels()
    np.testing.assert_allclose(camera.project(camera.unproject(pixels, depth)), pixels, atol=1e-4)


def test_points_behind_the_camera_give_finite_values_and_gradients(camera):
    points = jnp.asarray([[0.1, 0.2, 0.0], [0.1, 0.2, -1.0]])
    value, gradient = jax.value_and_grad(lambda p: jnp.sum(camera.project(p)))(points)
    assert jnp.isfinite(value)
    assert jnp.all(jnp.isfinite(gradient))


@pytest.mark.parametrize("factor", [2, 3])
def test_downscaled_camera_sees_block_centres(camera, factor):
    small = camera.downscaled(factor)
    assert small.shape == (24 // factor, 32 // factor)
    ray = camera.unproject(jnp.asarray([(factor - 1) / 2, (factor - 1) / 2]), jnp.asarray(1.0))
    np.testing.assert_allclose(small.project(ray), [0.0, 0.0], atol=1e-5)


def test_intrinsics_are_strong_float32_so_that_nothing_compiles_twice(camera):
    other = Camera(np.float64(50), 60, jnp.asarray(15.5), 11.0, width=32, height=24)
    for a, b in zip(jax.tree.leaves(camera), jax.tree.leaves(other), strict=True):
        assert (a.dtype, a.weak_type) == (b.dtype, b.weak_type) == (jnp.float32, False)


def test_intrinsics_are_differentiable(camera):
    point = jnp.asarray([0.1, 0.2, 2.0])
    gradient = jax.grad(lambda c: c.project(point)[0])(camera)
    np.testing.assert_allclose(gradient.fx, 0.05, rtol=1e-6)
    np.testing.assert_allclose(gradient.cx, 1.0)
    assert gradient.fy == 0


def test_a_camera_prints_its_numbers():
    camera = Camera(517.3, 516.5, 318.6, 255.25, width=640, height=480)
    assert repr(camera) == "Camera(fx=517.3, fy=516.5, cx=318.6, cy=255.25, width=640, height=480)"


def test_a_camera_without_numbers_prints_their_shapes(camera):
    printed = []
    jax.jit(lambda c: printed.append(repr(c)))(camera)
    several = jax.tree.map(lambda x: jnp.stack([x, x]), camera)
    for text in (printed[0], repr(several), repr(jax.tree.map(lambda _: None, camera))):
        assert text.startswith("Camera(fx=")
        assert "50" not in text
        assert text.endswith("width=32, height=24)")


def test_values_of_traced_intrinsics_are_not_looked_at():
    """An optimiser may pass through any of them; sizes and shapes are still checked."""

    def focal(fx):
        return Camera(fx, 60.0, 15.5, 11.0, width=32, height=24).matrix()[0, 0]

    with pytest.raises(InputError, match=r"fx of a Camera .* not 0\.0"):
        focal(jnp.asarray(0.0))
    assert jax.jit(focal)(jnp.asarray(0.0)) == 0
    assert jax.grad(focal)(jnp.asarray(-2.0)) == 1
