"""The way that a kidnapped camera takes, and its error where some poses are wrong."""

import numpy as np

from experiments.kidnapping import Walk, errors_of, way_of


def test_the_way_back_leads_over_what_was_missed():
    way = way_of(Walk("", before=6, jump=10, stride=2), start=100)
    assert way[:3] == [100, 102, 104]
    assert way[3:6] == [116, 118, 120]
    assert way[6:] == list(range(122, 100, -2))


def test_wrong_poses_do_not_turn_the_others(rng):
    true = rng.normal(size=(40, 3))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    positions = true @ turn.T + [3, -2, 1]
    positions[:12] += [5, 0, 0]
    errors = errors_of(positions, true)
    np.testing.assert_allclose(errors[12:], 0, atol=1e-6)
    np.testing.assert_allclose(errors[:12], 5, atol=1e-6)
