"""L1 and SSIM against direct sums."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import splatting

# One program for each instead of one for each operation.
l1, ssim = jax.jit(splatting.l1), jax.jit(splatting.ssim)


def direct_ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """SSIM of every pixel, window by window, as the paper defines it."""
    axis = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    window = np.outer(axis, axis) / axis.sum() ** 2
    a, b = (np.pad(image, ((5, 5), (5, 5), (0, 0))) for image in (a, b))
    height, width, channels = a.shape[0] - 10, a.shape[1] - 10, a.shape[2]
    result = np.zeros((height, width, channels))
    for v, u, c in np.ndindex(result.shape):
        x, y = a[v : v + 11, u : u + 11, c], b[v : v + 11, u : u + 11, c]
        mx, my = np.sum(window * x), np.sum(window * y)
        vx, vy = np.sum(window * (x - mx) ** 2), np.sum(window * (y - my) ** 2)
        cov = np.sum(window * (x - mx) * (y - my))
        result[v, u, c] = (
            (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
        )
    return result


@pytest.fixture
def images(rng):
    a = rng.random((19, 23, 3))
    return a, np.clip(a + 0.2 * rng.normal(size=a.shape), 0, 1)


def test_ssim_is_the_mean_over_the_windows(images):
    a, b = images
    expected = direct_ssim(a, b)
    assert 0.2 < expected.mean() < 0.95
    assert float(ssim(jnp.float32(a), jnp.float32(b))) == pytest.approx(expected.mean(), abs=2e-6)
    grey = float(ssim(jnp.float32(a[..., 0]), jnp.float32(b[..., 0])))
    assert grey == pytest.approx(expected[..., 0].mean(), abs=2e-6)


def test_ssim_of_equal_images_is_one_at_any_size(rng):
    for shape in [(1, 1), (3, 40, 3)]:
        image = jnp.asarray(rng.random(shape), jnp.float32)
        assert float(ssim(image, image)) == pytest.approx(1, abs=1e-6)


def test_masked_pixels_count_for_nothing(images):
    a, b = (jnp.float32(image) for image in images)
    mask = np.zeros(a.shape[:2], bool)
    mask[4:15, 3:20] = True
    empty = jnp.zeros_like(a)
    within = [jnp.where(mask[..., None], image, empty) for image in (a, b)]
    expected = direct_ssim(*(np.asarray(image, np.float64) for image in within))[mask].mean()
    spoiled = jnp.where(mask[..., None], a, jnp.nan)
    for loss, value in ((ssim, expected), (l1, np.abs(np.asarray(a - b))[mask].mean())):
        actual, gradient = jax.value_and_grad(loss)(spoiled, b, jnp.asarray(mask))
        assert float(actual) == pytest.approx(value, abs=2e-6)
        assert np.all(np.isfinite(gradient))
        assert np.all(np.asarray(gradient)[~mask] == 0)
        assert float(loss(a, b, jnp.zeros_like(mask))) == 0


@pytest.mark.usefixtures("float64")
def test_ssim_gradients_agree_with_finite_differences(images, rng):
    a, b = (jnp.asarray(image) for image in images)
    mask = jnp.asarray(rng.random(a.shape[:2]) > 0.3)
    gradients = jax.grad(ssim, argnums=(0, 1))(a, b, mask)
    for i, gradient in enumerate(gradients):
        direction = jnp.asarray(rng.normal(size=a.shape))
        (a_up, b_up), (a_down, b_down) = (
            [x + sign * 1e-6 * direction if i == j else x for j, x in enumerate((a, b))] for sign in (1, -1)
        )
        numerical = float(ssim(a_up, b_up, mask) - ssim(a_down, b_down, mask)) / 2e-6
        assert numerical == pytest.approx(float(jnp.sum(gradient * direction)), rel=1e-6)


@pytest.mark.parametrize("height", [1, 31, 33, 64, 70])
def test_ssim_does_not_depend_on_how_the_rows_are_cut(height, rng):
    a = rng.random((height, 12))
    b = np.clip(a + 0.2 * rng.normal(size=a.shape), 0, 1)
    whole = direct_ssim(a[..., None], b[..., None]).mean()
    assert float(ssim(jnp.float32(a), jnp.float32(b))) == pytest.approx(whole, abs=2e-6)


def test_ssim_can_be_mapped_over_a_batch(images):
    a, b = (jnp.stack([jnp.float32(image), 0.5 * jnp.float32(image)]) for image in images)
    values, gradients = jax.vmap(jax.value_and_grad(ssim))(a, b)
    for i in range(2):
        value, gradient = jax.value_and_grad(ssim)(a[i], b[i])
        assert float(values[i]) == pytest.approx(float(value), abs=1e-6)
        np.testing.assert_allclose(gradients[i], gradient, atol=1e-7)
