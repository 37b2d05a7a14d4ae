"""Depth that contradicts its colour or the frames before: nothing is believed that rests on it."""

from dataclasses import replace

import cv2
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Frame, slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.slam import PoseSource
from sfgs_jax.slam.frontend import depth_scale_change, is_noise, observe, register, watched
from sfgs_jax.slam.state import empty_synchrony

MAX_LAG = 1


@pytest.fixture(scope="module")
def lap():
    """A third of a lap of the room, decoded once, at the size of the other tests of this folder."""
    recording = SyntheticRecording(num_frames=60, width=160, height=120)
    return recording, [recording[number] for number in range(40)]


def late(frames, lag):
    """Each colour with the depth of an earlier frame, or of a later one."""
    last = len(frames) - 1
    return [
        replace(frame, depth=frames[min(max(number - lag, 0), last)].depth)
        for number, frame in enumerate(frames)
    ]


def lags_of(recording, frames, max_lag=MAX_LAG):
    """The lag that is believed after each frame."""
    synchrony, lags = empty_synchrony(recording.camera), []
    for frame in frames:
        synchrony = watched(synchrony, frame, max_lag)
        lags.append(synchrony.refused_lag)
    return lags


def scaled(frame, factor):
    return replace(frame, depth=np.asarray(frame.depth) * np.float32(factor))


@pytest.mark.parametrize("lag", [3, -3])
def test_depth_of_another_time_is_noticed_within_a_second(lap, lag):
    recording, frames = lap
    lags = lags_of(recording, late(frames, lag))
    first = next(number for number, found in enumerate(lags) if found)
    assert first < 30
    assert all(abs(found - lag) <= 1 for found in lags[first:])


@pytest.mark.parametrize("lag", [0, 1])
def test_depth_of_the_same_time_to_a_frame_is_left_alone(lap, lag):
    recording, frames = lap
    assert not any(lags_of(recording, late(frames, lag)))


def test_a_lag_that_is_allowed_is_known_too(lap):
    recording, frames = lap
    synchrony = empty_synchrony(recording.camera)
    for frame in late(frames, 1):
        synchrony = watched(synchrony, frame, MAX_LAG)
    assert (synchrony.lag, synchrony.refused_lag) == (1, 0)


@pytest.mark.parametrize(("mean", "lag", "refused"), [(0.9, 0, 0), (1.1, 2, 0), (2.0, 2, 2)])
def test_a_likely_lag_counts_before_frames_are_refused_for_it(lap, mean, lag, refused):
    """Forty frames count as ten: the means are 2.25, 2.75 and 5 of their standard errors."""
    recording, frames = lap
    synchrony = empty_synchrony(recording.camera)
    for frame in frames[:6]:
        synchrony = watched(synchrony, frame, 1)
    judged = len(synchrony.agreements)
    agreements = np.zeros_like(synchrony.agreements)
    agreements[:, agreements.shape[1] // 2 + 2] = mean + 1.26 * np.resize([1, -1], judged)
    synchrony = replace(synchrony, agreements=agreements, num_judged=judged)
    synchrony = watched(synchrony, frames[6], 1)
    assert (synchrony.lag, synchrony.refused_lag) == (lag, refused)


@pytest.mark.parametrize(("first", "last"), [(476, 523), (8960, 9020)])
def test_a_slow_way_past_outlines_on_one_side_tells_no_lag(first, last):
    """In a corridor all that is near lies on one side, and moves by a pixel from frame to frame."""
    recording = SyntheticRecording(place="building", num_frames=10000, width=160, height=120)
    synchrony = empty_synchrony(recording.camera)
    for number in range(first, last + 1):
        synchrony = watched(synchrony, recording[number], MAX_LAG)
        assert synchrony.lag == 0


def test_a_lag_is_over_when_depth_is_in_time_again(lap):
    recording, frames = lap
    # Back and forth, so that the second half shows what the first did.
    lags = lags_of(recording, late(frames, 3) + 2 * (frames[::-1] + frames))
    assert lags[len(frames) - 1] != 0
    assert lags[-1] == 0


def test_a_still_camera_tells_no_lag(lap):
    recording, frames = lap
    rng = np.random.default_rng(0)
    noise = rng.normal(scale=0.02, size=(30, *frames[0].rgb.shape)).astype(np.float32)
    still = [replace(frames[0], rgb=frames[0].rgb + change) for change in noise]
    assert not any(lags_of(recording, still))


def test_a_switched_off_check_looks_at_nothing(lap):
    recording, frames = lap
    before = empty_synchrony(recording.camera)
    assert watched(before, frames[0], 5) is before


def steps(recording, frames, config):
    """The state after some frames, and what happened to each."""
    state, infos = slam.init(recording.camera, config), []
    for frame in frames:
        state, info = slam.step(state, frame)
        infos.append(info)
    return state, infos


def test_frames_whose_depth_is_late_are_lost_and_the_reason_is_told(lap, config):
    recording, frames = lap
    with pytest.warns(UserWarning, match=r"Depth comes \d frames late against colour\."):
        state, infos = steps(recording, late(frames, 3), config)
    told = [number for number, info in enumerate(infos) if info.contradiction]
    assert told == list(range(told[0], len(frames)))
    assert not any(infos[number].tracked for number in told)
    assert all(info.tracked for info in infos[: told[0]])
    assert state.num_lost == len(told)
    assert np.isinf(np.diag(infos[-1].covariance)).all()


@pytest.fixture(scope="module")
def moving(lap, config):
    """A state after eight frames, of a camera that moves by 3 cm from one to the next."""
    recording, frames = lap
    return steps(recording, frames[:8], config)


def with_lag(state, lag):
    return replace(state, synchrony=replace(empty_synchrony(state.camera), lag=lag))


def test_a_pose_with_depth_a_frame_late_is_uncertain_by_the_motion_of_a_frame(lap, moving):
    state, infos = moving
    _, frames = lap
    in_time, late = (slam.step(with_lag(state, lag), frames[8])[1] for lag in (0, 1))
    assert late.tracked
    np.testing.assert_array_equal(late.T_world_cam.wxyz_xyz, in_time.T_world_cam.wxyz_xyz)
    moved = np.asarray(se3.log(se3.compose(se3.inverse(infos[-1].T_world_cam), late.T_world_cam)))
    np.testing.assert_allclose(
        late.covariance - in_time.covariance, np.outer(moved, moved), rtol=0.01, atol=5e-6
    )
    assert 0.02 < np.linalg.norm(moved[:3]) < 0.04


def test_a_lag_that_the_estimate_of_times_explains_costs_nothing(lap, moving):
    """Two thirds of a frame explain a lag of one, to which it is rounded, and not one of two."""
    state, _ = moving
    _, frames = lap
    delay = jnp.asarray(-0.67 / 30, jnp.float32)
    explained = eqx.tree_at(lambda s: s.tracker.last_motion.timing.depth_delay, state, delay)
    in_time, one, two = (slam.step(with_lag(explained, lag), frames[8])[1] for lag in (0, 1, 2))
    _, unexplained = slam.step(with_lag(state, 1), frames[8])
    np.testing.assert_array_equal(one.covariance, in_time.covariance)
    np.testing.assert_array_equal(two.covariance, unexplained.covariance)


def test_a_camera_too_fast_for_depth_so_late_is_lost_until_it_is_slow_again(lap, moving):
    """Depth is three frames late, 9 cm. Then the camera stays where it is."""
    state, _ = moving
    _, frames = lap
    state = with_lag(state, 3)
    for number in (8, 9):
        with pytest.warns(UserWarning, match=r"Depth comes 3 frames late against colour\."):
            state, info = slam.step(state, frames[number])
        assert not info.tracked
    for later in range(3):
        still = replace(frames[9], timestamp=frames[9].timestamp + (1 + later) / 30)
        state, info, _ = slam.follow(state, still)
    assert info.tracked
    truth = np.linalg.inv(lap[0].ground_truth.poses[0]) @ lap[0].ground_truth.poses[9]
    assert np.linalg.norm(np.asarray(info.T_world_cam.translation()) - truth[:3, 3]) < 0.01


@pytest.mark.parametrize(("factor", "word"), [(1.05, "longer"), (0.95, "shorter")])
def test_after_a_change_of_the_scale_of_depth_another_map_begins(lap, config, factor, word):
    """Poses after the change would be wrong by 5 % of the room, and fit as well as those before."""
    recording, frames = lap
    config = replace(config, graph=replace(config.graph, new_map_frames=6))
    changed = [scaled(frame, factor) if number >= 10 else frame for number, frame in enumerate(frames[:24])]
    with pytest.warns(UserWarning, match=f"% {word} than in the frames before"):
        _, infos = steps(recording, changed, config)
    assert all(info.tracked for info in infos[:10])
    begun = next(number for number, info in enumerate(infos) if info.new_map)
    assert not any(info.tracked for info in infos[10:begun])
    assert begun == 15
    assert all(info.tracked for info in infos[begun:])


@pytest.mark.parametrize("factor", [1.0, 1.04, 0.96])
def test_the_change_of_scale_is_measured(lap, config, factor):
    recording, frames = lap
    params = slam.init(recording.camera, config).params
    target, source = observe(params, frames[0]), observe(params, scaled(frames[2], factor))
    found = register(params, source, target, se3.identity())
    change, sigma = depth_scale_change(params, source, target, found.T_target_source, found.matched)
    assert float(sigma) < 0.01
    # Robust weights have their say: a large change is not seen whole.
    assert abs(float(change)) <= abs(np.log(factor)) + 0.002
    assert abs(float(change)) >= 0.6 * abs(np.log(factor)) - 3 * float(sigma)
    if factor != 1:
        assert np.sign(float(change)) == -np.sign(np.log(factor))
        assert int(found.source) == PoseSource.LOST


def plane(noise, distance=2.0):
    """A slanted plane with normal noise that is a share of its depth."""
    rng = np.random.default_rng(1)
    columns = np.linspace(-0.5, 0.5, 160)[None] + np.zeros((120, 1))
    depth = distance / (1 + 0.8 * columns)
    return jnp.asarray(depth * (1 + rng.normal(scale=noise, size=depth.shape)), jnp.float32)


@pytest.mark.parametrize(
    ("noise", "distance", "expected"),
    [(0, 2, False), (0.006, 2, False), (0.015, 2, True), (0.1, 2, True), (0.015, 8, False), (0.06, 8, True)],
)
def test_depth_that_scatters_is_noise(noise, distance, expected):
    assert bool(is_noise(plane(noise, distance), 0.01)) is expected


def test_edges_and_holes_are_no_noise():
    steps = np.where(np.arange(160) // 20 % 2, 1.0, 3.0) + np.zeros((120, 1))
    holes = np.where(np.random.default_rng(2).random((120, 160)) < 0.6, 0, 2.0)
    for depth in (steps, holes, np.zeros((120, 160))):
        assert not bool(is_noise(jnp.asarray(depth, jnp.float32), 0.01))


def test_noise_in_place_of_depth_leaves_a_frame_its_keypoints_alone(lap, config):
    """A single such frame is found by its reference's depth; a recording of such frames begins nowhere."""
    recording, frames = lap
    rng = np.random.default_rng(3)

    def noisy(frame):
        depth = np.asarray(frame.depth)
        return replace(frame, depth=(depth + rng.normal(0.2, 0.1, depth.shape)).astype(np.float32))

    state, _ = slam.step(slam.init(recording.camera, config), frames[0])
    state, info = slam.step(state, noisy(frames[1]))
    assert info.source == PoseSource.KEYPOINTS
    assert not info.new_keyframe
    state = slam.init(recording.camera, config)
    for frame in frames[:3]:
        state, info = slam.step(state, noisy(frame))
        assert not info.tracked


def test_a_mirrored_stream_is_not_found_by_its_walls(lap, config):
    """Without other maps: it may well have one of its own."""
    recording, frames = lap
    config = replace(config, graph=replace(config.graph, new_map_frames=0))

    def mirrored(frame):
        rgb, depth = (np.ascontiguousarray(np.asarray(x)[:, ::-1]) for x in (frame.rgb, frame.depth))
        return replace(frame, rgb=rgb, depth=depth)

    state = slam.init(recording.camera, config)
    for frame in frames[:10]:
        state, _ = slam.step(state, frame)
    for frame in frames[10:30]:
        state, info = slam.step(state, mirrored(frame))
        assert not info.tracked


@pytest.mark.parametrize("shift", [16, 32])
def test_a_small_thing_full_of_texture_is_not_the_world(lap, config, shift):
    """A box moves before a still camera. It fills a quarter of the image and has most of its contrast."""
    recording, frames = lap
    rng = np.random.default_rng(4)
    texture = cv2.GaussianBlur(rng.random((110, 40, 3)).astype(np.float32), (0, 0), 1.0)
    texture = (texture - texture.min()) / (texture.max() - texture.min())

    def with_box(left):
        rgb, depth = np.array(frames[0].rgb), np.array(frames[0].depth)
        rgb[5:115, left : left + 40], depth[5:115, left : left + 40] = texture, 1.0
        return Frame(rgb, depth, 0.0)

    params = slam.init(recording.camera, config).params
    target, source = observe(params, with_box(50)), observe(params, with_box(50 + shift))
    found = register(params, source, target, se3.identity())
    assert found.found
    assert float(jnp.max(jnp.abs(se3.log(found.T_target_source)))) < 0.005


def test_a_frame_is_lost_where_its_position_is_less_certain_than_the_bound(lap, config):
    recording, frames = lap
    strict = replace(config, tracking=replace(config.tracking, max_position_sigma=1e-4))
    state, first = slam.step(slam.init(recording.camera, strict), frames[0])
    state, second = slam.step(state, frames[1])
    assert first.tracked
    assert not second.tracked
    # It says by how much evidence the pose was missed, and nothing against the sensors.
    assert second.num_inliers > 20
    assert not second.contradiction
