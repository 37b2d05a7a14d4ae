"""Times of the rows, estimated while tracking a camera with rolling shutters and a delay."""

import operator
from dataclasses import replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory, se3
from sfgs_jax.gicp import RowMotion
from sfgs_jax.sensors import SensorModel, SensorTiming
from sfgs_jax.slam.frontend import Localised, place
from sfgs_jax.slam.state import Reference, TimingPrior, no_timing_information
from sfgs_jax.superfeats import mean_grey

FAULTS = KinectFaults(depth_delay=0.012, colour_readout=0.03, depth_readout=0.025)
COUNT = 45


@pytest.fixture(scope="module")
def recording():
    return SyntheticRecording(num_frames=60, width=192, height=144, faults=FAULTS)


@pytest.fixture(scope="module")
def frames(recording):
    """The frames, rendered once."""
    return [recording[i] for i in range(COUNT)]


@pytest.fixture(scope="module")
def tracking(config):
    """The settings of `test_depth_estimate`, whose frames are of the same size: one program serves both."""
    return replace(config.tracking, keyframe_translation=0.1)


class Run(NamedTuple):
    """Times found by a run with their covariance, its ATE, and its keyframes.

    `poses` are those in the world, each as it was tracked. `behind` has for each frame how far the times of
    the reference were from those known then.
    """

    params: slam.TrackerParams
    tracker: slam.Tracker
    last: slam.TrackInfo
    timing: SensorTiming
    covariance: jax.Array
    error: float
    keyframes: list[int]
    poses: np.ndarray
    behind: list[float]


@pytest.fixture(scope="module")
def tracked(recording, frames, tracking):
    """A run with the times estimated, one without, and one that begins with the times of the first."""

    def run(estimate_timing, timing=None):
        settings = replace(tracking, estimate_timing=estimate_timing)
        params = slam.tracker_params(recording.camera, settings, SensorModel(timing))
        tracker, infos, behind = slam.init_tracker(params), [], []
        for i, frame in enumerate(frames):
            elapsed = np.float32(1 / 30 if i else 0)
            tracker, info = slam.track(params, tracker, mean_grey(frame.rgb), frame.depth, elapsed)
            assert bool(info.tracked)
            infos.append(info)
            kept = jax.tree.map(operator.itemgetter(int(tracker.current)), tracker.reference_motions)
            known = slam.estimated_timing(params, tracker)[0]
            behind.append(float(abs(kept.timing.vector - known.vector).max()))
        poses = se3.matrices_of(np.stack([info.T_world_cam.wxyz_xyz for info in infos]))
        trajectory = Trajectory(recording.timestamps[:COUNT], poses)
        found, covariance = slam.estimated_timing(params, tracker)
        keyframes = [i for i, info in enumerate(infos) if info.new_keyframe]
        error = ate(trajectory, recording.ground_truth).rmse_m
        return Run(params, tracker, infos[-1], found, covariance, error, keyframes, poses, behind)

    first = run(True)
    return {"without": run(False), "first": first, "next": run(True, first.timing)}


def test_the_times_are_found_with_their_uncertainty(tracked):
    for run in ("first", "next"):
        truth = FAULTS.depth_delay, FAULTS.colour_readout, FAULTS.depth_readout
        off = np.asarray(tracked[run].timing.vector) - truth
        sigmas = np.sqrt(np.diag(tracked[run].covariance))
        np.testing.assert_array_less(abs(off), 0.002)
        np.testing.assert_array_less(abs(off), 4 * sigmas)


def test_errors_of_depth_do_not_pass_for_a_delay(tracking):
    """Bands of 3 cm at 2 m, and a camera 1 cm and 0.3 degrees beside its place, both unknown yet."""
    faults = replace(FAULTS, depth_bands=0.03, extrinsic_shift=0.01, extrinsic_turn=0.005)
    kinect = SyntheticRecording(num_frames=60, width=192, height=144, faults=faults)
    settings = replace(tracking, estimate_timing=True, estimate_depth=True, estimate_extrinsic=True)
    params = slam.tracker_params(kinect.camera, settings)
    tracker, surprises, sigmas = slam.init_tracker(params), [], np.zeros(3)
    for i in range(20):
        frame = kinect[i]
        elapsed = np.float32(1 / 30 if i else 0)
        tracker, _ = slam.track(params, tracker, mean_grey(frame.rgb), frame.depth, elapsed)
        timing, covariance = slam.estimated_timing(params, tracker)
        off = np.asarray(timing.vector) - (faults.depth_delay, faults.colour_readout, faults.depth_readout)
        surprises.append(off @ np.linalg.solve(covariance, off))
        sigmas = np.sqrt(np.diag(covariance))
    # With three times, chance exceeds it in one case of a thousand.
    assert max(surprises) < 16.3
    assert (sigmas < (0.004, 0.004, 0.008)).all()


def test_the_sum_is_the_least_squares_solution_with_depths_errors_as_unknowns(rng):
    """Registrations that tell of times and errors of depth together, and a prior of each."""
    sigmas, root = np.asarray([0.01, 0.02, 0.02]), np.tril(0.003 * rng.standard_normal((4, 4)))
    covariance = np.zeros((7, 7))
    covariance[:3, :3], covariance[3:, 3:] = np.diag(sigmas**2), root @ root.T
    true = np.linalg.cholesky(covariance) @ rng.standard_normal(7)
    prior = TimingPrior(jnp.asarray(sigmas, jnp.float32), jnp.asarray(root, jnp.float32))
    total, information, vector = no_timing_information(4, np.dtype(np.float32)), np.zeros((7, 7)), np.zeros(7)
    for _ in range(5):
        rows = rng.standard_normal((3, 7)) * [100, 50, 50, 300, 300, 300, 300]
        measured = rows @ true + rng.standard_normal(3)
        information, vector = information + rows.T @ rows, vector + rows.T @ measured
        told = jnp.asarray(rows.T @ rows, jnp.float32), jnp.asarray(rows.T @ measured, jnp.float32)
        total = total.plus(*told, prior)
    posterior = np.linalg.inv(information + np.linalg.inv(covariance))
    np.testing.assert_allclose(total.most_likely, posterior @ vector, rtol=2e-3, atol=1e-5)
    excess = max(1.0, float(total.chi_square / total.expected))
    scaled = np.linalg.inv(np.linalg.inv(posterior[:3, :3]) - np.diag(sigmas**-2.0))
    known = np.linalg.inv(np.linalg.inv(scaled) / excess + np.diag(sigmas**-2.0))
    np.testing.assert_allclose(total.covariance(prior.sigmas), known, rtol=5e-3, atol=1e-9)


def test_a_sum_over_many_frames_stays_finite(rng):
    """In float32 the information about depth's errors is no longer positive definite by then."""
    prior = TimingPrior(jnp.asarray([0.01, 0.02, 0.02]), jnp.eye(6, dtype=jnp.float32))
    rows = rng.standard_normal((2, 9))
    rounded = 1e9 * rows.T @ rows + 30 * np.diag(rng.standard_normal(9))
    told = no_timing_information(6, np.dtype(np.float32))
    total = told.plus(jnp.asarray(rounded, jnp.float32), jnp.zeros(9), prior)
    assert np.linalg.eigvalsh(rounded[3:, 3:]).min() < -1
    for leaf in jax.tree.leaves(total):
        assert np.isfinite(leaf).all()


def test_surfaces_alone_tell_the_readout_and_no_delay(recording, frames, tracking, rng):
    """A delay only moves what is seen along the way. Noise of the surfaces must not pass for one."""
    settings = replace(tracking, estimate_timing=True)
    params = slam.tracker_params(recording.camera, settings)
    tracker = slam.init_tracker(params)
    for i, frame in enumerate(frames):
        noise = rng.random(frame.depth.shape, np.float32)
        tracker, info = slam.track(params, tracker, noise, frame.depth, np.float32(1 / 30 if i else 0))
        assert i == 0 or int(info.source) == slam.PoseSource.SURFACE
    timing, covariance = slam.estimated_timing(params, tracker)
    delay, _, readout = np.sqrt(np.diag(covariance))
    assert abs(timing.depth_delay) < 1e-3 * settings.delay_sigma
    assert delay > 0.98 * settings.delay_sigma
    assert abs(timing.depth_readout - FAULTS.depth_readout) < 3 * readout < 0.005


def test_the_first_frame_gives_way_to_one_with_two_motions_behind_it(tracked):
    """Rows of the first lie where they were read. Others stay keyframes for as long as they are seen well."""
    assert tracked["first"].keyframes[:2] == [0, 2]
    assert tracked["without"].keyframes[1] > 2
    assert np.diff(tracked["first"].keyframes[1:]).min() > 2


def test_a_keyframe_follows_what_becomes_known_of_the_times(tracked, recording):
    """The first one is taken before anything is known of them: its rows lie where they were read."""
    found, true = tracked["first"].poses, recording.ground_truth.poses[:COUNT]
    first, before_the_next = 2, slice(5, 9)
    there, truly = (np.linalg.inv(poses[first]) @ poses[before_the_next] for poses in (found, true))
    off = np.linalg.inv(there) @ truly
    # With its rows left there, these frames are 27 to 33 mm off.
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.015


def test_the_reference_has_the_times_of_the_newest_frame(tracked):
    """They change by tens of milliseconds while the first ones are used."""
    for run in (tracked["first"], tracked["next"]):
        assert max(run.behind[3:]) <= 1e-3


@pytest.mark.parametrize("known", [True, False])
def test_frames_move_their_rows_where_those_of_the_keyframe_were_moved_that_they_are_found_in(tracked, known):
    params, tracker, last = tracked["first"][:3]
    twist = np.full(6, 0.1, np.float32)
    motion = RowMotion(*jax.device_put((twist, params.timing, np.asarray(known))))
    pose, keyframe = np.asarray(last.T_world_cam.wxyz_xyz), np.asarray(last.reference)
    reference = Reference(last.features, motion, pose, keyframe)
    found = Localised(reference, last.registration, bridged=False, relocalised=True)
    after, _ = place(params, tracker, last.features, found)
    kept = jax.tree.map(lambda ring: np.asarray(ring)[after.current], after.reference_motions)
    assert bool(kept.known) == known
    np.testing.assert_array_equal(kept.twist, twist)


def test_times_that_would_have_no_effect_are_refused(recording, tracking):
    with pytest.raises(InputError, match="estimate_timing"):
        slam.tracker_params(recording.camera, tracking, SensorModel(SensorTiming(depth_delay=0.01)))


def test_without_the_estimate_the_times_stay_what_they_were(tracked):
    np.testing.assert_array_equal(tracked["without"].timing.vector, 0)


def test_poses_are_better_for_it(tracked):
    without, first, following = (tracked[run].error for run in ("without", "first", "next"))
    assert first < 0.7 * without
    assert following < 0.5 * without
