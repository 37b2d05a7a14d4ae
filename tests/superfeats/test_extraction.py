"""Extraction: any image size, order and length of the results, gradients, batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import extract
from sfgs_jax.superfeats.network import fold, initialise_network


@pytest.fixture(scope="module")
def params():
    return fold(initialise_network(jax.random.key(0)))


def blocks(rng, height, width):
    """An image of random bright and dark blocks, with many corners."""
    coarse = rng.random((-(-height // 6), -(-width // 6)))
    return jnp.asarray(np.kron(coarse, np.ones((6, 6)))[:height, :width], jnp.float32)


@pytest.mark.parametrize("shape", [(64, 96), (61, 45), (7, 9), (1, 1)])
def test_any_image_size(params, shape, rng):
    features = extract(params, blocks(rng, *shape), max_keypoints=64)
    assert features.keypoints.shape == (64, 2)
    assert features.descriptors.shape == (64, 64)
    keypoints = np.asarray(features.keypoints)[np.asarray(features.valid)]
    assert np.all(keypoints >= -1)
    assert np.all(keypoints <= [shape[1], shape[0]])
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(features))


def test_valid_slots_come_first_with_falling_scores_and_unit_descriptors(params, rng):
    features = extract(params, blocks(rng, 64, 64), max_keypoints=2048)
    valid = np.asarray(features.valid)
    assert 10 < valid.sum() < 2048
    assert np.all(valid[: valid.sum()])
    assert np.all(np.diff(np.asarray(features.scores)) <= 0)
    lengths = np.linalg.norm(features.descriptors, axis=1)
    np.testing.assert_allclose(lengths[valid], 1, atol=1e-5)
    for values in (features.descriptors, features.keypoints, features.scores):
        assert np.all(np.asarray(values)[~valid] == 0)


def test_colour_is_its_mean_and_brightness_does_not_matter(params, rng):
    image = blocks(rng, 64, 64)
    grey = extract(params, image, max_keypoints=32)
    colours = jnp.stack([image, 0.5 * image, 1.5 * image], -1) * 0.7 + 0.1
    for kind in (colours, np.asarray(colours)):
        colour = extract(params, kind, max_keypoints=32)
        np.testing.assert_allclose(colour.keypoints, grey.keypoints, atol=1e-2)
        np.testing.assert_allclose(colour.descriptors, grey.descriptors, atol=1e-2)


def test_bytes_are_read_like_floats(params, rng):
    grey = np.rint(np.asarray(blocks(rng, 64, 64)) * 255)
    for image in (grey, np.stack([grey, 0 * grey, 200 - 0.5 * grey], -1).round()):
        floats, integers = (
            extract(params, image.astype(kind), max_keypoints=32) for kind in (np.float32, np.uint8)
        )
        np.testing.assert_array_equal(integers.keypoints, floats.keypoints)


def test_the_border_and_what_lies_beyond_bring_no_keypoints(params, rng):
    features = extract(params, blocks(rng, 40, 44), max_keypoints=512)
    keypoints = np.asarray(features.keypoints)[np.asarray(features.valid)]
    assert len(keypoints) > 10
    # A maximum is 4 pixels inside, and its centroid at most 2 from it.
    assert np.all(keypoints > 1.9)
    assert np.all(keypoints < [41.1, 37.1])


def test_a_threshold_leaves_out_the_weak_without_compiling_again(params, rng):
    image = blocks(rng, 64, 64)
    every, few = (extract(params, image, max_keypoints=256, min_heat=limit) for limit in (0.0, 0.03))
    assert 0 < int(few.valid.sum()) < int(every.valid.sum())


def test_a_flat_image_gives_finite_features(params):
    features = extract(params, jnp.full((64, 64), 0.5), max_keypoints=16)
    assert all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(features))


def test_gradients_reach_the_weights_through_descriptors_and_positions(params, rng):
    image = blocks(rng, 64, 64)

    def moment(params, part):
        features = extract(params, image, max_keypoints=16)
        return (getattr(features, part) ** 3).sum()

    through_descriptors = jax.grad(moment)(params, "descriptors")
    through_positions = jax.grad(moment)(params, "keypoints")
    for gradient in (through_descriptors, through_positions):
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))
    assert float(jnp.abs(through_descriptors.levels[0].reduce.weight).max()) > 0
    assert float(jnp.abs(through_descriptors.describe.weight).max()) > 0
    assert float(jnp.abs(through_positions.detect.weight).max()) > 0
    # The detection branch moves keypoints, and by that what is sampled; descriptors move none.
    assert float(jnp.abs(through_positions.describe.weight).max()) == 0


def test_the_gradient_is_the_slope(params, float64, rng):
    """By the weights of the descriptors, in float64."""
    image = jnp.asarray(blocks(rng, 64, 64), jnp.float64)
    params = jax.tree.map(lambda x: x.astype(jnp.float64) if eqx.is_inexact_array(x) else x, params)

    @jax.jit
    def mean_cosine(scale):
        weight = params.describe.weight
        changed = eqx.tree_at(lambda n: n.describe.weight, params, weight + scale * jnp.sin(100 * weight))
        features = extract(changed, image, max_keypoints=16)
        return (features.descriptors[0] * features.descriptors[1]).sum()

    step = 1e-5
    with jax.numpy_dtype_promotion("standard"):  # indices are int32 whatever the rest is
        slope = jax.jit(jax.grad(mean_cosine))(jnp.zeros(()))
        by_steps = (mean_cosine(jnp.asarray(step)) - mean_cosine(jnp.asarray(-step))) / (2 * step)
    assert abs(slope) > 1e-3
    np.testing.assert_allclose(slope, by_steps, rtol=1e-5)


def test_a_batch_is_the_same_as_one_by_one(params, rng):
    images = jnp.stack([blocks(rng, 64, 64), blocks(rng, 64, 64)])
    together = jax.vmap(lambda image: extract(params, image, max_keypoints=16))(images)
    for index in range(2):
        alone = extract(params, images[index], max_keypoints=16)
        np.testing.assert_allclose(together.keypoints[index], alone.keypoints, atol=1e-3)
        np.testing.assert_allclose(together.descriptors[index], alone.descriptors, atol=1e-4)


def test_unusable_input_is_refused(params):
    with pytest.raises(InputError, match="max_keypoints"):
        extract(params, jnp.zeros((8, 8)), max_keypoints=0)
    with pytest.raises(InputError, match="empty"):
        extract(params, jnp.zeros((0, 8)))
