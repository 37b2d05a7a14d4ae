"""Repeatability, matching and corner errors where the answer is known."""

import numpy as np
import pytest

from sfgs_jax.evaluation import (
    corner_error,
    correct_matches,
    estimate_homography,
    matching_score,
    repeatability,
    transfer,
)

H = np.array([[1.1, 0.05, -20.0], [-0.02, 0.95, 10.0], [1e-4, -5e-5, 1.0]])
SHAPE = (240, 320)


def test_places_are_those_of_the_projective_map_and_infinite_beyond_the_horizon():
    places = transfer(H, np.array([[0.0, 0.0], [100, 50]]))
    np.testing.assert_allclose(places, [[-20, 10], [92.5 / 1.0075, 55.5 / 1.0075]])
    tilted = np.array([[1.0, 0, 0], [0, 1, 0], [-0.01, 0, 1]])
    assert np.isinf(transfer(tilted, np.array([[150.0, 0]]))).all()


def test_repeatability_by_hand():
    shift = np.array([[1.0, 0, 10], [0, 1, 0], [0, 0, 1]])
    # The last keypoint of a leaves image b; the last of b was not in image a.
    a = np.array([[20.0, 20], [50, 60], [100, 100], [315, 30]])
    b = np.array([[32.0, 20], [60, 63], [200, 200], [5, 30]])
    # Seen by both: 3 and 3. At 2 pixels one of each has a partner, at 3 two, at 1 none.
    found = [repeatability(a, b, shift, SHAPE, SHAPE, threshold_px=t) for t in (1.0, 2.0, 3.0)]
    np.testing.assert_allclose(found, [0, 2 / 6, 4 / 6])
    nothing = np.zeros((0, 2))
    assert repeatability(nothing, b, shift, SHAPE, SHAPE) == 0


def test_matching_score_counts_correct_matches_among_keypoints_seen_by_both():
    shift = np.array([[1.0, 0, 10], [0, 1, 0], [0, 0, 1]])
    a = np.array([[20.0, 20], [50, 60], [100, 100], [315, 30]])
    b = np.array([[31.0, 20], [60, 60], [200, 200], [5, 30], [111, 100]])
    matched_a, matched_b = a[:3], b[[0, 1, 2]]
    np.testing.assert_array_equal(correct_matches(matched_a, matched_b, shift), [True, True, False])
    # 2 correct; of a 3 keypoints are seen by both, of b 4.
    score = matching_score(matched_a, matched_b, a, b, shift, SHAPE, SHAPE)
    assert score == pytest.approx((2 / 3 + 2 / 4) / 2)


def test_homography_is_found_among_mismatches(rng):
    a = rng.uniform([0, 0], SHAPE[::-1], (150, 2))
    b = transfer(H, a) + rng.normal(0, 0.3, a.shape)
    b[:50] = rng.uniform([0, 0], SHAPE[::-1], (50, 2))
    estimate = estimate_homography(a, b)
    assert corner_error(estimate, H, SHAPE) < 1
    np.testing.assert_array_equal(estimate, estimate_homography(a, b))
    assert corner_error(estimate_homography(a[:3], b[:3]), H, SHAPE) == np.inf


def test_corner_error_is_the_mean_distance_of_the_corners():
    moved = np.array([[1.0, 0, 3], [0, 1, 4], [0, 0, 1]]) @ H
    assert corner_error(moved, H, SHAPE) == pytest.approx(5)
    assert corner_error(H, H, SHAPE) == 0
    assert corner_error(5 * H, H, SHAPE) == pytest.approx(0, abs=1e-9)
