"""The slope filter on matches whose motion is known."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import Matches, MotionFilterConfig, filter_by_motion, match
from tests.superfeats.feature_sets import make_features, unit


def scene(rng, *, right: int, wrong: int, empty: int = 8):
    """Points that move by about (12, -5), then points that move anywhere, then empty slots."""
    n = right + wrong
    valid = np.arange(n + empty) < n
    positions = rng.uniform(50, 590, (n + empty, 2))
    moved = positions + np.array([12, -5]) + rng.normal(0, 1.0, positions.shape)
    moved[right:] = rng.uniform(50, 590, moved[right:].shape)
    descriptors = unit(rng.normal(size=(n + empty, 64)))
    return make_features(positions, descriptors, valid), make_features(moved, descriptors, valid)


def test_scattered_matches_are_removed_and_those_of_the_motion_kept(rng):
    a, b = scene(rng, right=150, wrong=100)
    matches = match(a, b)
    assert int(matches.valid.sum()) == 250
    kept = filter_by_motion(a, b, matches)
    valid = np.asarray(kept.valid)
    assert valid[:150].all()
    assert valid[150:250].sum() <= 2
    assert not valid[250:].any()
    np.testing.assert_array_equal(np.asarray(kept.index_b), np.where(valid, matches.index_b, 0))
    np.testing.assert_allclose(np.asarray(kept.similarity), np.where(valid, matches.similarity, 0), atol=1e-6)


def test_motion_that_varies_smoothly_stays(rng):
    a, _ = scene(rng, right=200, wrong=0)
    zoomed = make_features(np.asarray(a.keypoints) * 1.02, np.asarray(a.descriptors), np.asarray(a.valid))
    matches = match(a, zoomed)
    kept = filter_by_motion(a, zoomed, matches)
    assert int(kept.valid.sum()) >= 0.97 * int(matches.valid.sum())


@pytest.mark.parametrize(("right", "taken_in"), [(15, 10), (25, 0)])
def test_second_best_matches_are_taken_in_when_few_remain(rng, right, taken_in):
    """Ten keypoints are most like a wrong counterpart, and a little less like the right one."""
    a, b = scene(rng, right=right + 10, wrong=0, empty=10)
    descriptors_a, descriptors_b = np.array(a.descriptors), np.array(b.descriptors)
    valid_b = np.array(b.valid)
    decoys = np.flatnonzero(~valid_b)
    positions_b = np.array(b.keypoints)
    positions_b[decoys] = rng.uniform(50, 590, (10, 2))
    descriptors_b[decoys] = descriptors_a[right : right + 10]
    descriptors_b[right : right + 10] = unit(
        descriptors_a[right : right + 10] + 0.03 * rng.normal(size=(10, 64))
    )
    b = make_features(positions_b, descriptors_b)
    matches = match(a, b)
    np.testing.assert_array_equal(matches.index_b[right : right + 10], decoys)

    kept = filter_by_motion(a, b, matches)
    assert np.asarray(kept.valid)[:right].all()
    rescued = np.asarray(kept.valid)[right : right + 10]
    assert rescued.sum() == taken_in
    if taken_in:
        np.testing.assert_array_equal(kept.index_b[right : right + 10], np.arange(right, right + 10))
        assert np.all(np.asarray(kept.similarity)[right : right + 10] > 0.82)
    none = filter_by_motion(a, b, matches, config=MotionFilterConfig(min_matches=0))
    assert int(none.valid.sum()) == right


def test_nothing_in_gives_nothing_out_with_finite_gradients(rng):
    a, b = scene(rng, right=0, wrong=0)

    def total(descriptors):
        features = make_features(np.zeros((8, 2)), np.zeros((8, 64)), np.zeros(8, bool))
        features = jax.tree.map(lambda x: x, features)
        moved = type(features)(features.keypoints, features.scores, descriptors, features.valid)
        return jnp.sum(filter_by_motion(moved, b, match(moved, b)).similarity)

    assert not np.any(filter_by_motion(a, b, match(a, b)).valid)
    assert np.all(np.asarray(jax.grad(total)(a.descriptors)) == 0)


def test_gradients_of_kept_matches_are_finite_and_of_dropped_ones_zero(rng):
    a, b = scene(rng, right=60, wrong=20)

    def total(descriptors):
        moved = type(a)(a.keypoints, a.scores, descriptors, a.valid)
        return jnp.sum(filter_by_motion(moved, b, match(moved, b)).similarity)

    kept = np.asarray(filter_by_motion(a, b, match(a, b)).valid)
    gradient = np.asarray(jax.grad(total)(a.descriptors))
    assert 60 <= kept.sum() < 80
    np.testing.assert_allclose(gradient[kept], np.asarray(b.descriptors)[kept], atol=1e-7)
    assert not gradient[~kept].any()


def test_a_batch_gives_what_its_pairs_give(rng):
    scenes = [scene(rng, right=15, wrong=15), scene(rng, right=28, wrong=2)]
    stack = [jax.tree.map(lambda x, y: jnp.stack([x, y]), *pair) for pair in zip(*scenes, strict=True)]
    batch = jax.vmap(lambda a, b: filter_by_motion(a, b, match(a, b)))(*stack)
    for i, (a, b) in enumerate(scenes):
        single: Matches = filter_by_motion(a, b, match(a, b))
        np.testing.assert_array_equal(batch.valid[i], single.valid)
        np.testing.assert_array_equal(batch.index_b[i], single.index_b)


@pytest.mark.parametrize(
    "setting",
    [
        {"tolerance": -1.0},
        {"relative_tolerance": -0.1},
        {"min_share": 1.1},
        {"min_matches": -1},
        {"min_similarity": -0.1},
    ],
)
def test_settings_out_of_range_are_refused(setting):
    (name,) = setting
    with pytest.raises(InputError, match=f"The setting {name} must be a"):
        MotionFilterConfig(**setting)
