"""Frames of a rolling shutter against what a global shutter sees at the same time."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import gicp
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam import frontend
from sfgs_jax.slam.state import FrameFeatures, Keypoints
from sfgs_jax.superfeats import Features

FAULTS = KinectFaults(depth_delay=0.015, depth_readout=0.025)
TIMING = SensorTiming(FAULTS.depth_delay, FAULTS.colour_readout, FAULTS.depth_readout)
NUMBER = 20
STEP = 1e-3

# One program instead of one for each operation.
rectified = jax.jit(frontend.rectified)


@pytest.fixture(scope="module")
def recordings():
    faulty = SyntheticRecording(num_frames=60, width=128, height=96, faults=FAULTS)
    return faulty, replace(faulty, faults=None)


@pytest.fixture(scope="module")
def motion(recordings):
    """The true motion of the camera at the frame's time."""
    at = recordings[0].timestamps[NUMBER]
    before, after = recordings[0].poses_at(np.asarray([at - STEP, at + STEP]))
    moved = se3.from_matrix(np.linalg.inv(before) @ after)
    return gicp.RowMotion(se3.log(moved) / (2 * STEP), TIMING, jnp.asarray(True))


def cloud_of(recording):
    settings = gicp.GicpConfig(levels=2, strides=(1, 1), max_iterations=(10, 10))
    return gicp.prepare(recording[NUMBER].depth, recording.camera, config=settings)


def keypoints_at(recording, pixels):
    """Keypoints at given pixels, with the depth measured there."""
    depth = jnp.asarray(recording[NUMBER].depth)[pixels[:, 1], pixels[:, 0]]
    count, at = len(pixels), jnp.asarray(pixels, jnp.float32)
    features = Features(at, jnp.ones(count), jnp.zeros((count, 64)), jnp.ones(count, bool))
    return Keypoints(features, depth, recording.camera.unproject(at, depth), jnp.zeros(64))


@pytest.fixture(scope="module")
def seen(recordings):
    faulty, _ = recordings
    u, v = np.meshgrid(np.arange(12, 120, 8), np.arange(12, 88, 8))
    return FrameFeatures(cloud_of(faulty), keypoints_at(faulty, np.stack([u, v], axis=-1).reshape(-1, 2)))


def off_surface(level, truth):
    """Median distance of a level's pixels from the true surface there."""
    along = np.sum(np.asarray(level.points - truth.points) * truth.normals, axis=-1)
    return float(np.median(abs(along)[np.asarray(level.valid & truth.valid)]))


def test_the_surface_is_where_a_global_shutter_sees_it(recordings, seen, motion):
    faulty, ideal = recordings
    found = rectified(seen, faulty.camera, motion)
    for before, after, truth in zip(
        seen.cloud.levels, found.cloud.levels, cloud_of(ideal).levels, strict=True
    ):
        assert off_surface(before, truth) > 0.004
        assert off_surface(after, truth) < 0.25 * off_surface(before, truth)
        assert np.mean(after.valid) > 0.9 * np.mean(before.valid)


def test_keypoints_get_the_depth_of_their_own_time(recordings, seen, motion):
    faulty, ideal = recordings
    pixels = np.asarray(seen.keypoints.features.keypoints, int)
    truth = np.asarray(ideal[NUMBER].depth)[pixels[:, 1], pixels[:, 0]]
    found = rectified(seen, faulty.camera, motion).keypoints
    # Colour has no shutter here, so that its pixels stay.
    np.testing.assert_allclose(found.features.keypoints, pixels, atol=1e-3)
    before, after = (np.median(abs(np.asarray(k.depth) - truth)) for k in (seen.keypoints, found))
    assert before > 0.004
    assert after < 0.25 * before


def test_a_camera_that_stands_still_changes_nothing(recordings, seen):
    still = gicp.RowMotion(jnp.zeros(6), TIMING, jnp.asarray(False))
    found = rectified(seen, recordings[0].camera, still)
    np.testing.assert_allclose(found.cloud.levels[0].surface, seen.cloud.levels[0].surface, atol=1e-6)
    np.testing.assert_allclose(found.keypoints.depth, seen.keypoints.depth, rtol=1e-6)
