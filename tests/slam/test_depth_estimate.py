"""Distortion of depth: its equations, their sum, and its estimate during a run."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, grid_shares
from sfgs_jax.slam.frontend import recorrected
from sfgs_jax.slam.keyframes import depth_equations
from sfgs_jax.slam.state import depth_prior, no_depth_information

PRIOR = depth_prior((2, 3), 0.01, 0.01, 0.01)


def make_recording(seed):
    """A camera whose depth has bands of 3 cm at 2 m, and is seen from 1 cm and 0.6 degrees beside."""
    faults = KinectFaults(depth_bands=0.03, extrinsic_shift=0.01, extrinsic_turn=0.01)
    return SyntheticRecording(num_frames=50, width=192, height=144, seed=seed, faults=faults)


@pytest.fixture(scope="module")
def recording():
    return make_recording(seed=3)


@pytest.fixture(scope="module")
def pair():
    """Two frames of a place where both keypoints and surface show all of the motion."""
    recording = make_recording(seed=0)
    return recording[0], recording[8]


@pytest.fixture(scope="module")
def frames(recording):
    """The frames, rendered once."""
    return [recording[i] for i in range(len(recording))]


@pytest.fixture(scope="module")
def settings(config):
    tracking = replace(config.tracking, keyframe_translation=0.1)
    graph = replace(config.graph, num_neighbours=4)
    return replace(config, tracking=tracking, graph=graph)


@pytest.fixture(scope="module")
def runs(recording, frames, settings, all_compilations):
    """States after a run with the distortion estimated, warmed up before, and after one without."""

    def run(estimate_depth):
        tracking = replace(
            settings.tracking, estimate_depth=estimate_depth, estimate_extrinsic=estimate_depth
        )
        config = replace(settings, tracking=tracking)
        state = slam.init(recording.camera, config)
        # `test_step` warms up without the estimate; here programs that only a lost frame needs would be idle.
        if estimate_depth:
            slam.warm_up(recording.camera, config)
        all_compilations.clear()
        for number, frame in enumerate(frames):
            state, info, _ = slam.follow(state, frame, number=number)
            assert info.tracked
        assert not (estimate_depth and all_compilations)
        return state

    return {on: run(on) for on in (True, False)}


def test_the_distortion_is_found_with_its_uncertainty(recording, runs):
    state = runs[True]
    found = np.asarray(state.params.depth_correction.image(recording.camera))
    truth = recording.inverse_depth_offsets
    assert np.sqrt(np.mean((found - truth) ** 2)) < np.std(truth) / 3
    pixels = recording.camera.pixels().reshape(-1, 2)
    estimate = slam.estimated_depth(state)
    assert estimate is not None
    shares = np.asarray(grid_shares(pixels, recording.camera))
    covariance = estimate[1][:-6, :-6]
    sigma = np.sqrt(np.einsum("gn,gh,hn->n", shares, covariance, shares)).reshape(truth.shape)
    assert np.mean(((found - truth) / sigma) ** 2) < 2
    assert sigma.mean() < np.std(truth)


def test_the_extrinsic_is_found_with_its_uncertainty(recording, runs):
    estimate = slam.estimated_depth(runs[True])
    assert estimate is not None
    correction, covariance = estimate
    truth = se3.logs_of(recording.T_colour_depth[None])[0]
    off, sigmas = np.asarray(correction.extrinsic) - truth, np.sqrt(np.diag(covariance)[-6:])
    # Fifty frames turn too little to show more of it.
    assert np.linalg.norm(off[3:]) < 0.8 * np.linalg.norm(truth[3:])
    assert (sigmas < [0.01] * 6).all()
    # There are six degrees of freedom: chance exceeds it in one case of a thousand.
    assert off @ np.linalg.solve(covariance[-6:, -6:], off) < 22.5


def test_the_distortion_does_no_harm_to_the_poses(recording, runs):
    errors = {on: ate(state.trajectory, recording.ground_truth).rmse_m for on, state in runs.items()}
    assert errors[True] < 0.045
    assert errors[True] < errors[False] * 2 / 3


def test_references_and_edges_follow_the_estimate(runs):
    state = runs[True]
    np.testing.assert_allclose(state.params.depth_correction.vector, state.graph.depth_parameters, atol=1e-7)
    assert all(edge.sensitivity.shape == (6, state.graph.depth_parameters.size) for edge in state.graph.edges)
    assert slam.estimated_depth(runs[False]) is None
    assert runs[False].graph.depth_parameters.size == 0


def test_recorrected_features_are_those_of_corrected_depth(recording, pair, settings):
    params = slam.tracker_params(recording.camera, replace(settings.tracking, estimate_depth=True))
    across = np.linspace(-1, 1, DEPTH_GRID[1])
    offsets = 0.01 * np.broadcast_to(np.sin(3 * across), DEPTH_GRID)
    change = DepthCorrection(jnp.asarray(offsets, jnp.float32))
    before = slam.observe(params, pair[0])
    wanted = slam.observe(replace(params, depth_correction=change), pair[0])
    found = recorrected(before, recording.camera, change)
    for a, b, raw in zip(found.cloud.levels, wanted.cloud.levels, before.cloud.levels, strict=True):
        both = np.asarray(a.valid) & np.asarray(b.valid)
        assert both.mean() > 0.9 * np.asarray(b.valid).mean()
        off, moved = (
            np.linalg.norm((np.asarray(x.points) - np.asarray(b.points))[both], axis=-1) for x in (a, raw)
        )
        assert np.median(moved) > 0.01
        assert np.percentile(off, 95) < 0.004
        turned, kept = (
            np.sum((np.asarray(x.normals) * np.asarray(b.normals))[both], axis=-1) for x in (a, raw)
        )
        assert np.mean(1 - turned) < np.mean(1 - kept) / 5
    # At an outline the correction may decide whether a keypoint's depth is believed.
    both = (np.asarray(found.keypoints.depth) > 0) & (np.asarray(wanted.keypoints.depth) > 0)
    assert both.sum() > 0.98 * np.count_nonzero(wanted.keypoints.depth)
    np.testing.assert_allclose(found.keypoints.points[both], wanted.keypoints.points[both], atol=2e-3)


@pytest.fixture(scope="module")
def registered():
    """Two frames of a room and their registration, with the parameters that it has."""
    room = SyntheticRecording(num_frames=60, width=256, height=192)
    tracking = replace(slam.SlamConfig().tracking, estimate_depth=True, estimate_extrinsic=True)
    params = slam.tracker_params(room.camera, tracking)
    a, b = (slam.observe(params, room[number]) for number in (0, 8))
    found = slam.register(params, b, a, slam.register(params, b, a, se3.identity()).T_target_source)
    return params, b, a, found


def test_keypoints_show_the_extrinsic_and_surfaces_alone_the_distortion(registered):
    """So surfaces can be heard before the rows of keypoints are known to lie where they belong."""
    told = depth_equations(*registered)
    alone, both = (np.diag(some.information) for some in (told.by_surface, told.by_both))
    assert (alone[-6:] < 0.1 * both[-6:]).all()
    assert alone[:-6].sum() > 0.5 * both[:-6].sum()


def test_exact_depth_tells_little_more_than_noisy_depth(registered):
    """Without noise a little is left, as at creases: it is alike in all pairs and would add up."""
    params, told = registered[0], []
    for noise in (False, True):
        room = SyntheticRecording(num_frames=60, width=256, height=192, noise=noise)
        a, b = (slam.observe(params, room[number]) for number in (0, 8))
        equations = depth_equations(params, b, a, slam.register(params, b, a, se3.identity()))
        told.append(np.trace(equations.by_surface.information[:-6, :-6]))
    assert told[0] < 1.5 * told[1]


def test_the_sensitivity_says_how_the_motion_changes(registered):
    params, b, a, found = registered
    predicted = depth_equations(params, b, a, found).sensitivity
    across, down = np.meshgrid(np.linspace(-1, 1, DEPTH_GRID[1]), np.linspace(-1, 1, DEPTH_GRID[0]))
    changes = [np.r_[0.004 * pattern.ravel(), np.zeros(6)] for pattern in (across, down, across**2)]
    changes += [np.r_[np.zeros(across.size), motion] for motion in np.diag([0.01] * 3 + [0.005] * 3)]
    for change in changes:
        correction = params.depth_correction.with_vector(jnp.asarray(change, jnp.float32))
        moved = [recorrected(x, params.camera, correction) for x in (b, a)]
        again = slam.register(params, moved[0], moved[1], found.T_target_source)
        by = np.asarray(se3.log(se3.compose(se3.inverse(found.T_target_source), again.T_target_source)))
        expected = predicted @ change
        assert np.linalg.norm(by) > 4e-4
        assert np.linalg.norm(by - expected) < 0.4 * np.linalg.norm(by)


def equations(rng, offsets, sigma):
    """Ten measurements of linear functions of the offsets, with their noise."""
    rows = rng.normal(size=(10, len(offsets)))
    seen = rows @ offsets + sigma * rng.normal(size=10)
    return rows.T @ rows / sigma**2, rows.T @ seen / sigma**2


def test_the_sum_is_the_least_squares_solution_and_its_covariance_is_honest(rng):
    errors, ratio = [], []
    for _ in range(200):
        truth, start = PRIOR.root @ rng.normal(size=6), np.full(6, 0.002)
        depth = no_depth_information(start)
        for _ in range(30):
            used = rng.normal(0, 0.01, 6)
            information, vector = equations(rng, start + truth - used, 0.02)
            depth = depth.plus(information, vector, used, PRIOR)
        off = depth.estimate(PRIOR) - (start + truth)
        errors.append(off @ np.linalg.solve(depth.covariance(PRIOR), off))
        ratio.append(depth.chi_square / depth.expected)
    # A factor that is never below 1 is a little large on average.
    assert 4 < np.mean(errors) < 6.5
    assert np.mean(ratio) == pytest.approx(1, rel=0.1)


def test_registrations_that_contradict_each_other_count_for_less(rng):
    truth, depth, agreed = PRIOR.root @ rng.normal(size=6), *2 * [no_depth_information(np.zeros(6))]
    for _ in range(20):
        # Each has an error of its own, ten times as large as it says.
        information, vector = equations(rng, truth + 0.02 * rng.normal(size=6), 0.002)
        depth = depth.plus(information, vector, np.zeros(6), PRIOR)
        agreed = agreed.plus(information, information @ truth, np.zeros(6), PRIOR)
    assert depth.excess > 20
    assert agreed.excess == 1
    sigmas, told = (np.sqrt(np.diag(x.covariance(PRIOR))) for x in (depth, agreed))
    assert (sigmas > 3 * told).all()
    assert (abs(depth.estimate(PRIOR) - truth) < 4 * sigmas).all()
