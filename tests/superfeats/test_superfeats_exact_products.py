"""SuperFeats on devices whose default products are TF32.

Coordinates and cosines stay in float32. The network's convolutions do not, and hardly change the features.
"""

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.superfeats import Features, extract, filter_by_motion, load_weights, match
from sfgs_jax.superfeats.detection import refine
from sfgs_jax.superfeats.training import dual_softmax_loss, reprojection_loss, unit
from tests.superfeats.feature_sets import make_features
from tests.tf32 import at_tf32, default_products

HIDDEN = jnp.zeros((320, 320), bool)


def test_keypoints_are_carried_over_exactly(rng):
    logits = jnp.asarray(2 * rng.normal(size=(2, 40, 40, 65)), jnp.float32)
    H_b_a = jnp.asarray([[0.9, 0.15, 20.0], [-0.12, 0.95, 30.0], [1e-4, -5e-5, 1.0]])

    def evaluate(logits, H_b_a):
        return jax.value_and_grad(lambda x: reprojection_loss(x[0], x[1], H_b_a, HIDDEN, HIDDEN))(logits)

    assert default_products(evaluate, logits, H_b_a) == []
    loss, gradient = jax.jit(evaluate)(logits, H_b_a)
    rounded_loss, rounded_gradient = at_tf32(evaluate)(logits, H_b_a)
    assert float(rounded_loss) == pytest.approx(float(loss), rel=1e-5)
    np.testing.assert_allclose(rounded_gradient, gradient, atol=1e-4 * float(jnp.abs(gradient).max()))
    wrong, _ = at_tf32(evaluate, every=True)(logits, H_b_a)
    assert float(wrong) != pytest.approx(float(loss), rel=1e-4)


def test_centroids_are_exact(rng):
    heat = jnp.asarray(rng.random((8, 8, 4, 4)), jnp.float32)
    pixels = jnp.asarray(rng.integers(4, 28, (50, 2)), jnp.float32)
    assert default_products(refine, heat, pixels) == []
    np.testing.assert_array_equal(at_tf32(refine)(heat, pixels), jax.jit(refine)(heat, pixels))
    assert float(jnp.abs(at_tf32(refine, every=True)(heat, pixels) - refine(heat, pixels)).max()) > 1e-4


def crowd(rng, count: int) -> Features:
    """Descriptors that differ little, so that rounding exchanges nearest neighbours."""
    common = np.cos(np.arange(64.0))
    descriptors = common + 0.02 * rng.normal(size=(count, 64))
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    return make_features(rng.uniform(0, 640, (count, 2)), descriptors)


def test_neighbours_are_those_of_exact_cosines(rng):
    a, b = crowd(rng, 200), crowd(rng, 220)

    def indices(a, b):
        matches = match(a, b)
        return matches.index_b, filter_by_motion(a, b, matches).valid

    assert default_products(indices, a, b) == []
    exact = indices(a, b)
    for found, expected in zip(at_tf32(indices)(a, b), exact, strict=True):
        np.testing.assert_array_equal(found, expected)
    wrong, _ = at_tf32(indices, every=True)(a, b)
    assert np.mean(np.asarray(wrong) != np.asarray(exact[0])) > 0.05


def test_losses_of_descriptors_are_exact(rng):
    a, b = (unit(jnp.asarray(rng.normal(size=(64, 64)), jnp.float32)) for _ in range(2))

    def loss(a, b):
        return jax.value_and_grad(dual_softmax_loss)(a, b, jnp.ones(64, bool))

    assert default_products(loss, a, b) == []


def test_tf32_convolutions_hardly_change_the_features(sfgs_data):
    """Measured: of 1024 keypoints of a real image, shares that stay, pixels that they move, cosines."""
    path = sfgs_data / "data" / "7scenes" / "redkitchen" / "frame-000000.color.jpg"
    image = jnp.asarray(cv2.imread(str(path))[..., ::-1].astype(np.float32) / 255)
    params = load_weights()

    def found(params, image):
        return extract(params, image, max_keypoints=1024)

    products = default_products(found, params, image)
    assert all(product.left[0] >= 16 for product in products)
    exact, rounded = found(params, image), at_tf32(found)(params, image)
    gaps = np.linalg.norm(exact.keypoints[:, None] - rounded.keypoints[None], axis=-1)
    nearest, distance = gaps.argmin(axis=1), gaps.min(axis=1)
    same = distance < 0.5
    cosines = np.sum(np.asarray(exact.descriptors) * np.asarray(rounded.descriptors)[nearest], axis=1)
    print(
        same.mean(),
        np.median(distance[same]),
        np.percentile(distance[same], 99),
        np.percentile(cosines[same], 1),
    )
    assert same.mean() > 0.98
