"""ORB as `Features`."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.superfeats import extract_orb, match


@pytest.fixture
def blocks(rng):
    """A grey image of random blocks, in [0, 1], 240 rows by 320 columns."""
    coarse = rng.random((15, 20)).astype(np.float32)
    return cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_NEAREST)


def test_keypoints_follow_a_shifted_image(blocks):
    shifted = np.roll(blocks, (-6, 10), axis=(0, 1))
    a, b = (extract_orb(image, max_keypoints=300) for image in (blocks, shifted))
    assert a.keypoints.shape == (300, 2)
    assert a.descriptors.shape == (300, 256)
    assert a.descriptors.dtype == jnp.float32
    valid = np.asarray(a.valid)
    assert valid.sum() > 200
    assert not np.asarray(a.keypoints)[~valid].any()
    scores = np.asarray(a.scores)[valid]
    assert np.all(scores[:-1] >= scores[1:])
    matches = match(a, b, min_similarity=0.8)
    found = np.asarray(matches.valid)
    motion = np.asarray(b.keypoints)[np.asarray(matches.index_b)] - np.asarray(a.keypoints)
    right = np.linalg.norm(motion[found] - [10, -6], axis=1) < 2
    assert found.sum() > 80
    assert right.mean() > 0.95


def test_similarity_is_that_of_the_hamming_distance(blocks):
    features = extract_orb(blocks, max_keypoints=50)
    grey = np.rint(blocks * 255).astype(np.uint8)
    found, bits = cv2.ORB.create(nfeatures=50).detectAndCompute(grey, None)
    order = np.argsort([-keypoint.response for keypoint in found], kind="stable")[:50]
    hamming = np.bitwise_count(bits[order][:, None] ^ bits[order][None]).sum(axis=2)
    n = int(features.valid.sum())
    cosines = np.asarray(features.descriptors @ features.descriptors.T)[:n, :n]
    np.testing.assert_allclose(cosines, 1 - 2 * hamming / 256, atol=1e-6)


def test_colour_is_taken_as_its_luminance(blocks):
    colour = np.stack([blocks] * 3, axis=2)
    np.testing.assert_array_equal(extract_orb(colour).keypoints, extract_orb(blocks).keypoints)


@pytest.mark.parametrize("shape", [(120, 160), (8, 8), (37, 501)])
def test_images_without_corners_have_no_keypoints(shape):
    features = extract_orb(np.full(shape, 0.5, np.float32), max_keypoints=16)
    assert not np.any(features.valid)
    assert features.descriptors.shape == (16, 256)
    assert not np.any(features.descriptors)
