"""Gains of images against the colours of a map, and the file that holds them."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.sensors import fitted_gain, format_gains, read_gains, with_gain

GAIN = np.asarray([1.3, 0.9, 0.7], np.float32)


@pytest.fixture
def scene(rng):
    return rng.uniform(0.2, 0.7, (40, 60, 3)).astype(np.float32)


def everywhere(scene):
    return jnp.ones(scene.shape[:2])


def test_the_gain_of_each_channel_is_found(scene):
    shown = with_gain(jnp.asarray(scene), jnp.asarray(GAIN))
    found = fitted_gain(jnp.asarray(scene), shown, everywhere(scene), 0.0)
    np.testing.assert_allclose(found, GAIN, rtol=1e-5)


def test_noise_and_blur_of_the_map_have_no_influence(scene, rng):
    """Least squares would find 0.6 here: the noise has as much variance as the scene."""
    noisy = scene + rng.normal(scale=0.15, size=scene.shape).astype(np.float32)
    found = fitted_gain(jnp.asarray(noisy), jnp.asarray(GAIN * scene), everywhere(scene), 0.0)
    np.testing.assert_allclose(found, GAIN, rtol=0.02)


def test_the_fewer_pixels_there_are_the_closer_the_gain_is_to_one(scene):
    shown, pixels = with_gain(jnp.asarray(scene), jnp.asarray(GAIN)), scene.shape[0] * scene.shape[1]
    few = jnp.zeros(scene.shape[:2]).at[:10].set(1.0)
    found = [
        np.asarray(fitted_gain(jnp.asarray(scene), shown, weights, 0.3 * pixels))
        for weights in (everywhere(scene), few, 0 * few)
    ]
    # The scene is 0.45 bright, a typical image 0.4.
    for gain, share in zip(found, (0.45 / 0.57, 0.1125 / 0.2325, 0), strict=True):
        np.testing.assert_allclose(gain - 1, share * (GAIN - 1), rtol=0.05, atol=1e-6)


def test_a_black_image_leaves_a_gain_that_can_be_undone(scene):
    black = jnp.zeros_like(scene)
    for a, b in ((scene, black), (black, scene), (black, black)):
        found = np.asarray(fitted_gain(jnp.asarray(a), jnp.asarray(b), everywhere(scene), 0.0))
        assert np.isfinite(found).all()
        assert (found >= 0.25).all()
        assert (found <= 4).all()


def test_gains_come_back_from_their_file(tmp_path, rng):
    times, gains = np.arange(5) / 30, rng.uniform(0.5, 2, (5, 3))
    (tmp_path / "exposure.txt").write_text(format_gains(times, gains))
    found = read_gains(tmp_path / "exposure.txt")
    np.testing.assert_allclose(found[0], times, atol=1e-6)
    np.testing.assert_allclose(found[1], gains, atol=1e-6)


@pytest.mark.parametrize("line", ["1 2 3", "1 2 3 x", "1 nan 1 1", "1 0 1 1", "1 1 1 1 1"])
def test_a_file_of_something_else_is_refused(tmp_path, line):
    path = tmp_path / "exposure.txt"
    path.write_text(line + "\n")
    with pytest.raises(InputError, match=r"exposure.txt"):
        read_gains(path)
