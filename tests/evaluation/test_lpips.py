import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.evaluation.images import feature_distance, load_lpips, lpips, max_pool, unit_length

_SHAPE = (67, 90, 3)  # both pools see odd and even sides


@pytest.fixture(scope="module")
def distance():
    return jax.jit(lpips)


@pytest.fixture
def weights(sfgs_data):
    return load_lpips(sfgs_data / "weights/lpips_squeeze_v0.1.npz")


@pytest.fixture
def image(rng):
    """Smooth blobs of colour."""
    v, u = np.mgrid[: _SHAPE[0], : _SHAPE[1]] / 20
    waves = [np.sin(u * a + v * b + c) for a, b, c in rng.uniform(0, 3, (3, 3))]
    return (0.5 + 0.4 * np.stack(waves, axis=-1)).astype(np.float32)


def _numpy_features(arrays: dict[str, np.ndarray], image: np.ndarray) -> list[np.ndarray]:
    """SqueezeNet 1.1 written out position by position: channels last, the taps' features."""

    def convolve(x, name, stride=1, pad=0):
        weight = arrays[f"backbone.{name}.weight"].astype(np.float64)
        size = weight.shape[-1]
        x = np.pad(x, ((pad, pad), (pad, pad), (0, 0)))
        rows, columns = (range(0, n - size + 1, stride) for n in x.shape[:2])
        y = [[np.einsum("ijc,ocij->o", x[i : i + size, j : j + size], weight) for j in columns] for i in rows]
        return np.maximum(np.asarray(y) + arrays[f"backbone.{name}.bias"], 0)

    def pool(x):
        rows, columns = (range(0, 2 * int(np.ceil((n - 3) / 2)) + 1, 2) for n in x.shape[:2])
        return np.asarray([[x[i : i + 3, j : j + 3].max(axis=(0, 1)) for j in columns] for i in rows])

    def fire(x, number):
        x = convolve(x, f"{number}.squeeze")
        wide = [convolve(x, f"{number}.expand1x1"), convolve(x, f"{number}.expand3x3", pad=1)]
        return np.concatenate(wide, axis=-1)

    x = (2 * image.astype(np.float64) - 1 - [-0.030, -0.088, -0.188]) / [0.458, 0.448, 0.450]
    taps = [convolve(x, "0", stride=2)]
    for numbers in [(3, 4), (6, 7)]:
        x = pool(taps[-1])
        for number in numbers:
            x = fire(x, number)
        taps.append(x)
    taps.append(fire(pool(taps[-1]), 9))
    for number in (10, 11, 12):
        taps.append(fire(taps[-1], number))
    return taps


def test_agrees_with_the_network_written_out(sfgs_data, weights, image, rng, distance):
    arrays = dict(np.load(sfgs_data / "weights/lpips_squeeze_v0.1.npz"))
    a = image[:38, :45]
    b = np.clip(a + 0.1 * rng.normal(size=a.shape), 0, 1).astype(np.float32)
    expected = 0.0
    for i, (x, y) in enumerate(zip(_numpy_features(arrays, a), _numpy_features(arrays, b), strict=True)):
        x, y = (f / (np.linalg.norm(f, axis=-1, keepdims=True) + 1e-10) for f in (x, y))
        expected += np.mean((x - y) ** 2 @ arrays[f"lin{i}.model.1.weight"].reshape(-1))
    assert float(distance(weights, a, b)) == pytest.approx(expected, rel=1e-4)


def test_equal_images_have_no_distance(weights, image, distance):
    assert float(distance(weights, image, image)) < 1e-12


def test_grows_with_distortion_and_is_symmetric(weights, image, rng, distance):
    noise = rng.normal(size=image.shape).astype(np.float32)
    distances = [float(distance(weights, image, image + size * noise)) for size in (0.02, 0.08, 0.3)]
    assert 0 < distances[0] < distances[1] < distances[2]
    assert float(distance(weights, image + 0.3 * noise, image)) == pytest.approx(distances[2], rel=1e-5)


def test_features_are_compared_by_direction():
    """At one position the features are parallel, at the other at right angles: 2 and 3 by their weights."""
    a = jnp.asarray([[[3.0, 0.0], [5.0, 0.0]]])
    b = jnp.asarray([[[7.0, 0.0], [0.0, 0.1]]])
    assert float(feature_distance(a, b, jnp.asarray([2.0, 3.0]))) == pytest.approx((0 + 5) / 2)


def test_features_of_zero_stay_zero_with_finite_gradients():
    x = jnp.asarray([[0.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(unit_length(x), [[0, 0], [0.6, 0.8]], rtol=1e-6)
    gradient = jax.grad(lambda x: unit_length(x).sum())(x)
    assert bool(jnp.isfinite(gradient).all())


def test_pooling_counts_windows_past_the_edge():
    x = jnp.arange(6, dtype=jnp.float32).reshape(1, 1, 6, 1) * jnp.ones((1, 3, 1, 1))
    np.testing.assert_array_equal(max_pool(x)[0, :, :, 0], [[2, 4, 5]])
    assert max_pool(jnp.zeros((1, 33, 46, 1))).shape == (1, 16, 23, 1)


def test_missing_or_foreign_weights_are_an_input_error(tmp_path):
    with pytest.raises(InputError, match="Cannot read the LPIPS weights"):
        load_lpips(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", something=np.zeros(3))
    with pytest.raises(InputError, match=r"backbone"):
        load_lpips(tmp_path / "other.npz")
