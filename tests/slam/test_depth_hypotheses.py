"""Errors of depth that may be there or not: what registrations decide, and what stays open."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import DEPTH_GRID
from sfgs_jax.slam import SlamConfig, observe, register, tracker_params
from sfgs_jax.slam.keyframes import depth_equations
from sfgs_jax.slam.state import depth_estimate, depth_prior, no_depth_information, prior_of

TRACKING = replace(SlamConfig().tracking, estimate_depth=True, estimate_extrinsic=True)
WIDE = prior_of(TRACKING)
SIZE = DEPTH_GRID[0] * DEPTH_GRID[1] + 6


def heard(rng, truth, start, sigma=0.02):
    """Sum of what two pairs say, each by measurements of 160 linear functions of the parameters."""
    depth = no_depth_information(start)
    for _ in range(2):
        rows = rng.normal(size=(160, SIZE))
        rows[:, -6:] *= 0.3
        off = rows @ (truth - start) + sigma * rng.normal(size=160)
        depth = depth.plus(rows.T @ rows / sigma**2, rows.T @ off / sigma**2, start, WIDE)
    return depth


def drawn(rng, distorted, beside):
    """True parameters, of some share of what the settings expect."""
    return WIDE.root @ rng.normal(size=SIZE) * np.repeat([distorted, beside], [SIZE - 6, 6])


def test_the_estimate_is_honest_over_cameras_of_all_kinds(rng):
    """Also where it says that there is no such error, and there is."""
    squares, errors = [], {"all": [], "wide": []}
    for distorted in (0, 0.1, 1):
        for beside in (0, 1):
            for _ in range(15):
                start = 0.002 * rng.normal(size=SIZE)
                truth = start + drawn(rng, distorted, beside)
                depth = heard(rng, truth, start)
                mean, covariance = depth_estimate(depth, TRACKING)
                squares.append((mean - truth) @ np.linalg.solve(covariance, mean - truth))
                errors["all"].append(mean - truth)
                errors["wide"].append(depth.estimate(WIDE) - truth)
    assert 0.4 < np.mean(squares) / SIZE < 1.3
    by_all, by_wide = (np.sqrt(np.mean(np.square(x))) for x in errors.values())
    assert by_all < 0.9 * by_wide


def test_what_is_not_there_is_not_estimated(rng):
    """The wide prior alone would leave a hundred times the error, and fifty times the deviation."""
    start = 0.002 * rng.normal(size=SIZE)
    depth = heard(rng, start, start, sigma=0.003)
    mean, covariance = depth_estimate(depth, TRACKING)
    assert np.linalg.norm(mean - start) < 0.01 * np.linalg.norm(depth.estimate(WIDE) - start)
    assert np.sqrt(np.trace(covariance)) < 0.02 * np.sqrt(np.trace(depth.covariance(WIDE)))


def test_undecided_it_is_the_mean_of_all():
    start = np.linspace(0, 0.01, SIZE)
    mean, covariance = depth_estimate(no_depth_information(start), TRACKING)
    np.testing.assert_allclose(mean, start)
    wide = np.diag(np.linalg.inv(WIDE.information))
    # One camera in twenty has no such error. Distortions of a tenth are as likely as large ones.
    np.testing.assert_allclose(np.diag(covariance)[:-6] / wide[:-6], 0.95 * (1 + 0.01) / 2, rtol=1e-6)
    np.testing.assert_allclose(np.diag(covariance)[-6:] / wide[-6:], 0.95, rtol=1e-6)


def test_the_extrinsic_stays_where_it_is_not_estimated(rng):
    start, config = np.zeros(SIZE), replace(TRACKING, estimate_extrinsic=False)
    depth = heard(rng, drawn(rng, 1, 1), start)
    mean, covariance = depth_estimate(depth, config)
    assert np.abs(mean[-6:]).max() < 1e-5
    assert np.sqrt(np.diag(covariance)[-6:]).max() < 1e-5
    assert np.abs(mean[:-6]).max() > 1e-3


def test_the_evidence_is_how_likely_the_measurements_are(rng):
    priors = [depth_prior((2, 3), sigma, sigma, sigma) for sigma in (0.01, 0.05)]
    rows, seen, depth = rng.normal(size=(9, 6)), 0.02 * rng.normal(size=9), no_depth_information(np.zeros(6))
    depth = depth.plus(rows.T @ rows / 0.02**2, rows.T @ seen / 0.02**2, np.zeros(6), priors[1])
    # Fewer contradictions than expected, so each measurement counts in full.
    assert depth.excess == 1
    expected = [
        multivariate_normal(cov=rows @ np.linalg.inv(p.information) @ rows.T + 0.02**2 * np.eye(9)).logpdf(
            seen
        )
        for p in priors
    ]
    found = [depth.log_evidence(prior) for prior in priors]
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], abs=1e-6)


def test_exact_depth_of_a_room_is_left_as_it_is():
    """With a wide prior alone the extrinsic would be off by millimetres, which all poses would share."""
    room = SyntheticRecording(num_frames=60, width=256, height=192)
    params = tracker_params(room.camera, TRACKING)
    numbers = range(0, 49, 8)
    frames = {number: observe(params, room[number]) for number in numbers}
    depth = no_depth_information(np.zeros(SIZE))
    for a, b in pairwise(numbers):
        found = register(params, frames[b], frames[a], se3.identity())
        told = depth_equations(params, frames[b], frames[a], found).by_both
        depth = depth.plus(told.information, told.vector, np.zeros(SIZE), WIDE)
    by_all, by_wide = depth_estimate(depth, TRACKING).mean, depth.estimate(WIDE)
    assert np.linalg.norm(by_wide[-6:-3]) > 0.001
    assert np.linalg.norm(by_all[-6:-3]) < 0.0001
    assert np.abs(by_all[:-6]).max() < 0.1 * np.abs(by_wide[:-6]).max()
