"""track as a pure function: scanned and batched; counters and time in the tracker."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import se3
from sfgs_jax.slam import PoseSource
from sfgs_jax.superfeats import mean_grey

COUNT = 60
SECONDS = np.float32(1 / 30)


@pytest.fixture(scope="module")
def params(room, config):
    return slam.tracker_params(room.camera, config.tracking)


@pytest.fixture(scope="module")
def sequence(frames):
    """Sixty frames: the room's twelve, forwards and backwards."""
    order = np.resize([*range(len(frames)), *range(len(frames) - 2, 0, -1)], COUNT)
    grey = np.stack([mean_grey(frames[i].rgb) for i in order])
    depth = np.stack([frames[i].depth for i in order])
    return jnp.asarray(grey), jnp.asarray(depth), np.full(COUNT, SECONDS)


@pytest.fixture(scope="module")
def called(params, sequence):
    """Poses and keyframe decisions of sixty calls."""
    tracker, poses, keyframes = slam.init_tracker(params), [], []
    for grey, depth, elapsed in zip(*sequence, strict=True):
        tracker, info = slam.track(params, tracker, grey, depth, elapsed)
        poses.append(np.asarray(info.T_world_cam.wxyz_xyz))
        keyframes.append(bool(info.new_keyframe))
    return np.stack(poses), keyframes


def test_a_scan_gives_the_poses_of_single_calls(params, sequence, called, room):
    poses, keyframes = called
    _, found = slam.track_sequence(params, slam.init_tracker(params), *sequence)
    np.testing.assert_allclose(found.T_world_cam.wxyz_xyz, poses, atol=2e-5)
    assert list(found.new_keyframe) == keyframes
    assert sum(keyframes) > 1
    truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses
    np.testing.assert_allclose(poses[11, 4:], truth[11, :3, 3], atol=0.03)


def test_a_batch_of_recordings_is_tracked_at_once(params, sequence, called):
    grey, depth, _ = sequence
    starts = (0, 5)

    def batch(x):
        return jnp.stack([x[s : s + 4] for s in starts], axis=1)

    tracker = jax.vmap(lambda _: slam.init_tracker(params))(jnp.arange(2))
    track = jax.vmap(slam.track, in_axes=(None, 0, 0, 0, None))
    infos = []
    for images, depths in zip(batch(grey), batch(depth), strict=True):
        tracker, info = track(params, tracker, images, depths, SECONDS)
        infos.append(info)
    info = infos[-1]
    assert list(info.source) == [PoseSource.JOINT] * 2
    poses, _ = called
    np.testing.assert_allclose(info.T_world_cam.wxyz_xyz[0], poses[3], atol=2e-5)
    # The second recording begins where its first frame was.
    world = se3.matrices_of(poses)
    expected = np.linalg.inv(world[5]) @ world[8]
    np.testing.assert_allclose(info.T_world_cam.wxyz_xyz[1, 4:], expected[:3, 3], atol=0.02)


def test_a_sequence_has_a_depth_and_a_time_for_each_image(params, sequence):
    grey, depth, elapsed = sequence
    with pytest.raises(InputError, match="3 images, 2 depths and 3 times"):
        slam.track_sequence(params, slam.init_tracker(params), grey[:3], depth[:2], elapsed[:3])


def test_one_program_serves_every_frame(params, sequence, compilations):
    grey, depth, _ = sequence
    tracker = slam.init_tracker(params)
    tracker, _ = slam.track(params, tracker, grey[0], depth[0], SECONDS)
    compilations.clear()
    for i in (1, 5, 11):
        tracker, _ = slam.track(params, tracker, grey[i], depth[i], SECONDS)
    black, nothing = np.zeros(grey[0].shape, np.float32), np.zeros(depth[0].shape, np.float32)
    tracker, info = slam.track(params, tracker, black, nothing, SECONDS)
    assert int(info.source) == PoseSource.LOST
    assert not compilations


def test_the_motion_model_is_a_velocity(params, sequence):
    """A frame after twice the time is expected twice as far; a lost frame in between is time as well."""
    grey, depth, _ = sequence
    tracker = slam.init_tracker(params)
    for i in range(3):
        tracker, _ = slam.track(params, tracker, grey[i], depth[i], SECONDS)
    motion = np.asarray(se3.log(tracker.T_previous_current))

    def predicted(seconds):
        later = eqx.tree_at(lambda t: t.since_tracked, tracker, jnp.asarray(seconds))
        return np.asarray(se3.log(later.predicted_motion))

    np.testing.assert_allclose(predicted(SECONDS), motion, atol=1e-6)
    np.testing.assert_allclose(predicted(2 * SECONDS), 2 * motion, atol=1e-5)
    # Without time stamps the motion is one per frame.
    np.testing.assert_allclose(predicted(np.float32(0)), motion, atol=1e-6)
    lost, _ = slam.track(params, tracker, jnp.zeros_like(grey[0]), jnp.zeros_like(depth[0]), SECONDS)
    assert int(lost.lost_in_a_row) == 1
    found, info = slam.track(params, lost, grey[4], depth[4], SECONDS)
    assert int(info.source) != PoseSource.LOST
    assert int(found.lost_in_a_row) == 0
    np.testing.assert_allclose(found.motion_seconds, 2 * SECONDS, rtol=1e-5)


@pytest.mark.parametrize(("periods", "source"), [(1, PoseSource.SURFACE), (4, PoseSource.LOST)])
def test_after_missing_frames_the_surface_alone_has_to_agree_twice_as_well(
    params, sequence, rng, periods, source
):
    """A quarter of the image has come nearer, and no keypoint is left of what was there."""
    grey, depth, elapsed = sequence
    tracker = slam.init_tracker(params)
    for i in range(3):
        tracker, _ = slam.track(params, tracker, grey[i], depth[i], elapsed[i])
    noise = rng.random(grey[3].shape, np.float32)
    quarter = depth.shape[2] // 4
    nearer = depth[3].at[:, :quarter].multiply(0.7)
    _, info = slam.track(params, tracker, noise, nearer, periods * SECONDS)
    assert 0.76 < info.registration.agreement < 0.86
    assert info.source == source


def test_a_repeated_frame_is_the_one_before_it_again(params, sequence):
    """The next frame is two intervals after it, and moves on as fast as before."""
    grey, depth, elapsed = sequence
    shown, trackers, poses = (0, 1, 2, 2, 4), [slam.init_tracker(params)], []
    for number in shown:
        tracker, info = slam.track(params, trackers[-1], grey[number], depth[number], elapsed[0])
        assert info.tracked
        trackers.append(tracker)
        poses.append(info.T_world_cam)
    first, repeated, after = trackers[3:]
    np.testing.assert_allclose(poses[3].wxyz_xyz, poses[2].wxyz_xyz, atol=5e-4)
    np.testing.assert_allclose(repeated.since_tracked, SECONDS)
    np.testing.assert_allclose(repeated.motion_seconds, first.motion_seconds)
    speeds = [np.asarray(se3.log(t.T_previous_current) / t.motion_seconds) for t in (first, repeated, after)]
    np.testing.assert_allclose(speeds[1], speeds[0], atol=0.02)
    assert np.linalg.norm(speeds[0][:3]) > 0.1
    np.testing.assert_allclose(after.motion_seconds, 2 * SECONDS)
    assert np.linalg.norm(speeds[2][:3]) < 1.5 * np.linalg.norm(speeds[0][:3])


def test_other_depth_under_the_same_colours_is_another_frame(params, sequence):
    grey, depth, elapsed = sequence
    tracker = slam.init_tracker(params)
    for number in (0, 1, 2):
        tracker, _ = slam.track(params, tracker, grey[number], depth[number], elapsed[0])
    tracker, _ = slam.track(params, tracker, grey[2], depth[3], elapsed[0])
    assert tracker.since_tracked == 0
