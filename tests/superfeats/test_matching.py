"""Mutual nearest neighbours against a direct search."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.superfeats import Expected, Features, match
from tests.superfeats.feature_sets import make_features, unit


@pytest.fixture
def pair(rng):
    """80 and 96 slots, some empty; the first 40 of a are noisy copies of slots of b, in another order."""
    descriptors_b = unit(rng.normal(size=(96, 64)))
    order = rng.permutation(96)[:80]
    descriptors_a = unit(rng.normal(size=(80, 64)))
    noise = rng.uniform(0.01, 0.1, (40, 1))
    descriptors_a[:40] = unit(descriptors_b[order[:40]] + noise * rng.normal(size=(40, 64)))
    a = make_features(rng.uniform(0, 640, (80, 2)), descriptors_a, np.arange(80) % 7 != 3)
    b = make_features(rng.uniform(0, 640, (96, 2)), descriptors_b, np.arange(96) % 5 != 1)
    return a, b


def direct(a: Features, b: Features, floor: float) -> dict[int, tuple[int, float]]:
    """Matches by their definition, over the valid slots alone."""
    rows, columns = (np.flatnonzero(x.valid) for x in (a, b))
    table = np.asarray(a.descriptors)[rows] @ np.asarray(b.descriptors)[columns].T
    found = {}
    for i, j in enumerate(table.argmax(axis=1)):
        if table[:, j].argmax() == i and table[i, j] > floor:
            found[int(rows[i])] = (int(columns[j]), float(table[i, j]))
    return found


@pytest.mark.parametrize("floor", [0.0, 0.8, 0.95])
def test_matches_are_those_of_the_definition(pair, floor):
    a, b = pair
    matches = match(a, b, min_similarity=floor)
    expected = direct(a, b, floor)
    assert len(expected) > 5
    assert {int(i) for i in np.flatnonzero(matches.valid)} == expected.keys()
    for i, (j, similarity) in expected.items():
        assert int(matches.index_b[i]) == j
        assert float(matches.similarity[i]) == pytest.approx(similarity, abs=1e-6)
    assert not np.any(np.asarray(matches.index_b)[~np.asarray(matches.valid)])
    assert not np.any(np.asarray(matches.similarity)[~np.asarray(matches.valid)])
    assert matches.similarity.dtype == jnp.float32


def test_the_floor_tells_true_from_false(pair):
    low, high = (np.asarray(match(*pair, min_similarity=floor).valid) for floor in (0.0, 0.7))
    assert low[40:].sum() > 3
    assert high[40:].sum() == 0
    assert high[:40].sum() >= 20


def test_equal_descriptors_are_matched_once(rng):
    one = unit(rng.normal(size=(1, 32)))
    a, b = (make_features(np.zeros((n, 2)), np.repeat(one, n, axis=0)) for n in (4, 3))
    matches = match(a, b)
    assert np.asarray(matches.valid).tolist() == [True, False, False, False]
    assert int(matches.index_b[0]) == 0


@pytest.fixture
def tiles(rng):
    """A row of 12 tiles, 40 pixels wide, that look alike but for noise, and the same row 10 pixels on."""
    tile = np.repeat(unit(rng.normal(size=(1, 64))), 12, axis=0)
    places = np.stack([40.0 * np.arange(12), np.full(12, 100.0)], axis=1)
    b, a = (
        make_features(xy, unit(tile + 0.005 * rng.normal(size=(12, 64))))
        for xy in (places, places + np.asarray([10, 0]))
    )
    return a, b


def test_the_expected_places_tell_tiles_apart(tiles):
    a, b = tiles
    right = np.arange(12)
    blind = match(a, b)
    assert np.sum(np.asarray(blind.valid) & (np.asarray(blind.index_b) == right)) < 4
    for error in (0.0, 12.0, -12.0):  # of the motion that was expected, less than half a tile
        guided = match(a, b, expected=Expected(a.keypoints.at[:, 0].add(error), 160.0, 0.2))
        np.testing.assert_array_equal(guided.index_b, right)
        assert np.all(guided.valid)
        # A match is as similar as it looks, wherever it lies.
        cosine = np.sum(np.asarray(a.descriptors) * np.asarray(b.descriptors), axis=1)
        np.testing.assert_allclose(guided.similarity, cosine, rtol=1e-5)


def test_what_looks_like_nothing_else_matches_wherever_it_lies(pair, rng):
    a, b = pair
    far = jnp.asarray(rng.uniform(-1e4, 1e4, b.keypoints.shape), jnp.float32)
    unknown = far.at[::2].set(jnp.nan).at[1::2].set(jnp.inf)
    blind = match(a, b)
    for pixels in (far, unknown):
        guided = match(a, b, expected=Expected(pixels, 160.0, 0.2))
        np.testing.assert_array_equal(guided.valid, blind.valid)
        np.testing.assert_array_equal(guided.index_b, blind.index_b)


def test_empty_slots_never_match_whatever_they_hold(pair):
    a, b = pair
    spoiled = [
        eqx.tree_at(lambda x: x.descriptors, x, jnp.where(x.valid[:, None], x.descriptors, jnp.nan))
        for x in pair
    ]
    expected, actual = match(a, b), match(*spoiled)
    for left, right in zip(jax.tree.leaves(expected), jax.tree.leaves(actual), strict=True):
        np.testing.assert_array_equal(left, right)
    nothing = eqx.tree_at(lambda x: x.valid, b, jnp.zeros_like(b.valid))
    assert not np.any(match(a, nothing, min_similarity=0.0).valid)
    assert not np.any(match(nothing, a, min_similarity=0.0).valid)


def test_similarity_has_the_gradient_of_the_dot_product(pair):
    a, b = pair
    spoiled = eqx.tree_at(lambda x: x.descriptors, a, jnp.where(a.valid[:, None], a.descriptors, jnp.nan))

    def total(a, b):
        return jnp.sum(match(a, b).similarity)

    gradient_a, gradient_b = eqx.filter_grad(lambda pair: total(*pair))((spoiled, b))
    matches = match(a, b)
    valid, index = np.asarray(matches.valid), np.asarray(matches.index_b)
    expected_a = np.where(valid[:, None], np.asarray(b.descriptors)[index], 0)
    np.testing.assert_allclose(gradient_a.descriptors, expected_a, atol=1e-7)
    expected_b = np.zeros_like(b.descriptors)
    expected_b[index[valid]] = np.asarray(a.descriptors)[valid]
    np.testing.assert_allclose(gradient_b.descriptors, expected_b, atol=1e-7)


def test_a_batch_gives_what_its_pairs_give(pair, rng):
    a, b = pair
    others = [
        make_features(np.asarray(x.keypoints), unit(rng.normal(size=x.descriptors.shape))) for x in pair
    ]
    stacked = [
        jax.tree.map(lambda x, y: jnp.stack([x, y]), x, other) for x, other in zip(pair, others, strict=True)
    ]
    batch = jax.vmap(match)(*stacked)
    single = match(a, b)
    np.testing.assert_array_equal(batch.index_b[0], single.index_b)
    np.testing.assert_array_equal(batch.valid[0], single.valid)
    np.testing.assert_allclose(batch.similarity[0], single.similarity, atol=1e-6)


def test_what_cannot_be_matched_is_refused(pair):
    a, b = pair
    with pytest.raises(InputError, match=r"from 0 to 1, not -0\.1"):
        match(a, b, min_similarity=-0.1)
    short = make_features(np.zeros((3, 2)), np.ones((3, 32)))
    with pytest.raises(InputError, match="64 and 32 numbers"):
        match(a, short)
