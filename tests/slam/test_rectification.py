"""Frames of a rolling shutter against what a global shutter sees at the same time."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import gicp, slam
from sfgs_jax.datasets import KinectFaults, SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.sensors import SensorTiming, depth_in_time
from sfgs_jax.slam import frontend
from sfgs_jax.slam.keyframes import (
    prior_noise,
    rectified_anew,
    with_first_motion,
    with_motion_to_next,
    with_pairs_of_known_motion,
)
from sfgs_jax.slam.state import Edge, FrameFeatures, Keyframe, Keypoints, empty_graph
from sfgs_jax.superfeats import Features

FAULTS = KinectFaults(depth_delay=0.015, depth_readout=0.025)
TIMING = SensorTiming(FAULTS.depth_delay, FAULTS.colour_readout, FAULTS.depth_readout)
TIMES = np.asarray(TIMING.vector, np.float32)
NUMBER = 20
STEP = 1e-3

# One program instead of one for each operation.
rectified = jax.jit(frontend.rectified)
in_time = jax.jit(depth_in_time)


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
    points, normals = recording.camera.unproject(at, depth), jnp.zeros((count, 3))
    return Keypoints(features, depth, points, normals, jnp.zeros(64), places=at)


@pytest.fixture(scope="module")
def seen(recordings):
    faulty, _ = recordings
    u, v = np.meshgrid(np.arange(12, 120, 8), np.arange(12, 88, 8))
    keypoints = keypoints_at(faulty, np.stack([u, v], axis=-1).reshape(-1, 2))
    return FrameFeatures(cloud_of(faulty), keypoints, grey=jnp.zeros((0, 0)))


def off_surface(level, truth):
    """Median distance of a level's pixels from the true surface there."""
    along = np.sum((np.asarray(level.points) - truth.points) * np.asarray(truth.normals), axis=-1)
    return float(np.median(abs(along)[np.asarray(level.valid) & np.asarray(truth.valid)]))


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


def test_a_depth_image_is_brought_to_the_time_of_colour(recordings, motion):
    """Colour has no shutter here, so its time is the frame's."""
    faulty, ideal = recordings
    depth, truth = (np.asarray(r[NUMBER].depth) for r in (faulty, ideal))
    found = np.asarray(in_time(jnp.asarray(depth), faulty.camera, motion.twist, TIMING))
    known = (found > 0) & (truth > 0) & (depth > 0)
    assert known.sum() > 0.9 * np.sum(depth > 0)
    before, after = (np.median(abs(image - truth)[known]) for image in (depth, found))
    assert before > 0.004
    assert after < 0.35 * before
    still = in_time(jnp.asarray(depth), faulty.camera, jnp.zeros(6), TIMING)
    np.testing.assert_array_equal(still, depth)


def test_a_camera_that_stands_still_changes_nothing(recordings, seen):
    still = gicp.RowMotion(jnp.zeros(6), TIMING, jnp.asarray(False))
    found = rectified(seen, recordings[0].camera, still)
    np.testing.assert_allclose(found.cloud.levels[0].surface, seen.cloud.levels[0].surface, atol=1e-6)
    np.testing.assert_allclose(found.keypoints.depth, seen.keypoints.depth, rtol=1e-6)


@pytest.fixture
def early(recordings, seen):
    """A graph whose first keyframe was taken before its motion was known, tied to a second and a third."""
    config = slam.SlamConfig()
    params = slam.tracker_params(
        recordings[0].camera,
        replace(config.tracking, features=replace(config.tracking.features, kind="none")),
    )
    none, one = np.zeros(0), np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32)
    matrix, free = np.eye(6, dtype=np.float32), np.zeros((6, 0))
    keyframe = Keyframe(
        features=seen,
        landmarks=np.full(len(seen.keypoints.depth), -1),
        frame=NUMBER,
        reference=0,
        T_reference_keyframe=one,
        depth_parameters=none,
        twist=np.zeros(6, np.float32),
        times=np.zeros(3, np.float32),
        edition=0,
    )
    edges = tuple(
        Edge(a, b, one, matrix, one, matrix, False, loop, none, free, free)
        for a, b, loop in ((0, 1, False), (1, 2, False), (0, 2, True))
    )
    graph = empty_graph(none, prior_noise(config.graph), 0)
    return params, replace(graph, keyframes=(keyframe,), edges=edges)


def test_a_keyframe_is_rectified_once_its_motion_and_the_times_are_known(recordings, seen, motion, early):
    """In two steps it comes where it comes in one; its edges wait to be registered anew, but for the loop."""
    params, graph = early
    assert rectified_anew(params, graph, TIMES, slam.GraphConfig()) is graph, "its motion is unknown"
    graph = with_first_motion(graph, np.asarray(motion.twist))
    assert graph.keyframes[0].features is seen, "no times are known yet"
    graph = rectified_anew(params, graph, TIMES / 2, slam.GraphConfig())
    assert graph.again == ((0, 1),)
    graph = rectified_anew(params, graph, TIMES, slam.GraphConfig())
    assert [k.edition for k in graph.keyframes] == [2]
    assert len(graph.edges) == 3, "they hold until they are replaced"
    wanted = rectified(seen, recordings[0].camera, motion)
    pairs = zip(graph.keyframes[0].features.cloud.levels, wanted.cloud.levels, strict=True)
    for found, expected in pairs:
        both = np.asarray(found.valid) & np.asarray(expected.valid)
        assert both.mean() > 0.9 * np.mean(expected.valid)
        assert off_surface(found, expected) < 5e-4


def test_the_motion_to_the_next_frame_corrects_a_keyframe_whose_motion_changed(
    recordings, seen, motion, early
):
    """Its mean before the keyframe and after it are those of half an interval earlier and later."""
    params, graph = early
    rate = np.asarray([0.2, 0, 0, 0, 0, -1.0], np.float32)
    truth, seconds = np.asarray(motion.twist), 1 / 30
    own, following = (truth + s * seconds * rate for s in (-0.5, 0.5))
    features = rectified(seen, recordings[0].camera, replace(motion, twist=jnp.asarray(own)))
    keyframe = replace(graph.keyframes[0], features=features, twist=own, times=TIMES)
    graph = with_motion_to_next(params, replace(graph, keyframes=(keyframe,)), following, seconds)
    halfway = truth + FAULTS.depth_delay / 2 * rate
    np.testing.assert_allclose(graph.keyframes[0].twist, halfway, atol=1e-5)
    wanted = rectified(seen, recordings[0].camera, replace(motion, twist=jnp.asarray(halfway)))
    seen_by = graph.keyframes[0].features, features, wanted
    found, before, expected = (by.cloud.levels[0] for by in seen_by)
    assert off_surface(found, expected) < 0.2 * off_surface(before, expected)
    assert graph.keyframes[0].edition == 1


def test_a_keyframe_tells_the_motion_that_it_was_rectified_by(motion, early):
    keyframe, twist = early[1].keyframes[0], np.asarray(motion.twist)
    assert not bool(keyframe.motion.known)
    assert not bool(replace(keyframe, twist=twist).motion.known), "its rows lie where they were read"
    found = replace(keyframe, twist=twist, times=TIMES).motion
    assert bool(found.known)
    np.testing.assert_array_equal(found.twist, twist)
    np.testing.assert_array_equal(found.timing.vector, TIMES)


def test_a_keyframe_whose_times_are_unknown_keeps_its_motion(motion, early):
    params, graph = early
    assert with_motion_to_next(params, graph, np.asarray(motion.twist), 1 / 30) is graph


def test_pairs_of_a_keyframe_wait_for_its_motion_to_the_next_frame(early):
    params, graph = early
    keyframes = tuple(replace(graph.keyframes[0], frame=number) for number in (3, 7, NUMBER))
    graph = replace(graph, keyframes=keyframes, pending=((0, 1), (1, 2)))
    timed = replace(params, config=replace(params.config, estimate_timing=True))
    assert with_pairs_of_known_motion(params, graph, NUMBER) is graph, "nothing is rectified"
    assert with_pairs_of_known_motion(timed, graph, NUMBER + 1) is graph
    assert with_pairs_of_known_motion(timed, graph, NUMBER).pending == ((0, 1),)


def test_times_that_change_little_leave_keyframes_as_they_are(motion, early):
    params, graph = early
    graph = rectified_anew(
        params, with_first_motion(graph, np.asarray(motion.twist)), TIMES, slam.GraphConfig()
    )
    near = TIMES + np.float32(2e-4)
    assert rectified_anew(params, graph, near, slam.GraphConfig()) is graph
    again = rectified_anew(params, graph, near, slam.GraphConfig(), deviations=0.01)
    assert [k.edition for k in again.keyframes] == [2]
