"""Signatures of images: cosines of second moments, and the search among them."""

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.slam.frontend import image_signature, most_similar
from sfgs_jax.superfeats import Features


@pytest.fixture
def images(rng):
    """Keypoints of two images, the last ones invalid."""

    def features():
        descriptors = rng.normal(size=(20, 64)).astype(np.float32)
        valid = jnp.arange(20) < 15
        return Features(jnp.zeros((20, 2)), jnp.zeros(20), jnp.asarray(descriptors), valid)

    return features(), features()


def test_the_product_of_signatures_is_the_cosine_of_rooted_second_moments(images):
    signatures = [np.asarray(image_signature(features, components=24)) for features in images]
    whole = []
    for features in images:
        part = np.asarray(features.descriptors)[:15, :24].astype(np.float64)
        moments = part.T @ part
        rooted = np.sign(moments) * np.sqrt(np.abs(moments))
        whole.append(rooted / np.linalg.norm(rooted))
    assert signatures[0].shape == (24 * 25 // 2,)
    np.testing.assert_allclose(signatures[0] @ signatures[1], np.sum(whole[0] * whole[1]), atol=1e-5)
    np.testing.assert_allclose(signatures[0] @ signatures[0], 1, atol=1e-6)


def test_an_image_without_keypoints_has_a_signature_of_zeros(images):
    blank = Features(*(jnp.zeros_like(leaf) for leaf in vars(images[0]).values()))
    np.testing.assert_array_equal(image_signature(blank), 0)


@pytest.mark.parametrize(("count", "masked"), [(0, False), (1, False), (4, True), (40, True), (999, False)])
def test_the_search_finds_what_a_full_sort_finds(rng, count, masked):
    # Whole numbers, so that many cosines are equal: the earlier image is first then.
    signatures = rng.integers(-2, 3, (300, 6)).astype(np.float32)
    among = rng.random(300) < 0.1 if masked else np.ones(300, bool)
    found, cosines = most_similar(signatures, signatures[7], count, among=among if masked else None)
    order = np.argsort(-np.where(among, signatures @ signatures[7], -np.inf), kind="stable")
    np.testing.assert_array_equal(found, order[: min(count, among.sum())])
    np.testing.assert_array_equal(cosines, (signatures @ signatures[7])[found])


def test_nothing_is_found_where_nothing_is_looked_at():
    found, cosines = most_similar(
        np.eye(3, dtype=np.float32), np.ones(3, np.float32), 2, among=np.zeros(3, bool)
    )
    assert len(found) == len(cosines) == 0
