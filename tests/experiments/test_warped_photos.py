"""Changed photographs show the same places where their homography says."""

import cv2
import numpy as np
import pytest

from experiments.warped_photos import warped_photos
from sfgs_jax.datasets import read_photos
from sfgs_jax.evaluation import transfer


@pytest.fixture
def photos(tmp_path, rng):
    for n in range(3):
        coarse = rng.random((8, 12, 3)).astype(np.float32)
        smooth = cv2.resize(coarse, (180, 120), interpolation=cv2.INTER_CUBIC)
        assert cv2.imwrite(str(tmp_path / f"{n}.png"), np.clip(255 * smooth, 0, 255).astype(np.uint8))
    return read_photos(tmp_path)


def test_the_warped_image_shows_each_place_where_it_should_be(photos):
    pairs = [pair for pair in warped_photos(photos, count=3, seed=0) if pair.group == "viewpoint"]
    assert len(pairs) == 3
    v, u = np.mgrid[10:110:5, 10:170:5]
    for pair in pairs:
        points = np.stack([u.ravel(), v.ravel()], axis=1)
        places = transfer(pair.H_b_a, points.astype(np.float64))
        inside = np.all((places > 1) & (places < [178, 118]), axis=1)
        assert inside.sum() > 100
        x, y = places[None, inside].astype(np.float32).transpose(2, 0, 1)
        there = cv2.remap(pair.image_b, x, y, cv2.INTER_LINEAR)[0]
        here = pair.image_a[points[inside, 1], points[inside, 0]]
        assert np.abs(there - here).mean() < 0.02
        assert np.linalg.norm(places - points, axis=1).max() > 10


def test_other_light_moves_nothing_but_changes_much(photos):
    pairs = [pair for pair in warped_photos(photos, count=2, seed=0) if pair.group == "illumination"]
    assert len(pairs) == 2
    for pair in pairs:
        np.testing.assert_array_equal(pair.H_b_a, np.eye(3))
        assert np.abs(pair.image_b - pair.image_a).mean() > 0.05
        a, b = (image.mean(axis=2).ravel() for image in (pair.image_a, pair.image_b))
        assert np.corrcoef(a, b)[0, 1] > 0.7


def test_a_seed_gives_the_same_pairs(photos):
    first, again, other = (list(warped_photos(photos, count=3, seed=seed)) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first[2].image_b, again[2].image_b)
    assert np.abs(first[2].H_b_a - other[2].H_b_a).max() > 1e-3
