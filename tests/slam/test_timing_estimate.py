"""Times of the rows, estimated while tracking a camera with rolling shutters and a delay."""

from dataclasses import replace

import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory, se3
from sfgs_jax.sensors import SensorModel, SensorTiming
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


@pytest.fixture(scope="module")
def tracked(recording, frames, tracking):
    """Trackers and trajectories of a run with the times estimated, and of one without."""

    def run(estimate_timing, timing=None):
        settings = replace(tracking, estimate_timing=estimate_timing)
        params = slam.tracker_params(recording.camera, settings, SensorModel(timing))
        tracker, poses = slam.init_tracker(params), []
        for i, frame in enumerate(frames):
            elapsed = np.float32(1 / 30 if i else 0)
            tracker, info = slam.track(params, tracker, mean_grey(frame.rgb), frame.depth, elapsed)
            assert bool(info.tracked)
            poses.append(info.T_world_cam.wxyz_xyz)
        trajectory = Trajectory(recording.timestamps[:COUNT], se3.matrices_of(np.stack(poses)))
        return slam.estimated_timing(params, tracker), ate(trajectory, recording.ground_truth).rmse_m

    first = run(True)
    return {"without": run(False), "first": first, "next": run(True, first[0][0])}


def test_the_times_are_found_with_their_uncertainty(tracked):
    for run, tolerance in (("first", 0.004), ("next", 0.002)):
        (timing, covariance), _ = tracked[run]
        off = np.asarray(timing.vector) - (FAULTS.depth_delay, FAULTS.colour_readout, FAULTS.depth_readout)
        sigmas = np.sqrt(np.diag(covariance))
        np.testing.assert_array_less(abs(off), tolerance)
        np.testing.assert_array_less(abs(off), 4 * sigmas)


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


def test_times_that_would_have_no_effect_are_refused(recording, tracking):
    with pytest.raises(InputError, match="estimate_timing"):
        slam.tracker_params(recording.camera, tracking, SensorModel(SensorTiming(depth_delay=0.01)))


def test_without_the_estimate_the_times_stay_what_they_were(tracked):
    (timing, _), _ = tracked["without"]
    np.testing.assert_array_equal(timing.vector, 0)


def test_poses_are_better_for_it(tracked):
    without, first, following = (tracked[run][1] for run in ("without", "first", "next"))
    assert first < 0.7 * without
    assert following < 0.5 * without
