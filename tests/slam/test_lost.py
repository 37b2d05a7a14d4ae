"""Frames that show nothing, and how the system finds its way back."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import Frame, slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import PoseSource

THREE_LEVELS = GicpConfig(levels=3, strides=(1, 1, 1))


@pytest.fixture(scope="module")
def long_room():
    """Frames of a swing aside and back."""
    return SyntheticRecording(num_frames=60, width=160, height=120)


def follow(state, room, numbers):
    infos = []
    for i in numbers:
        state, info = slam.step(state, in_time(room[i] if i is not None else blank(room), state))
        infos.append(info)
    return state, infos


def blank(room):
    height, width = room.camera.shape
    return Frame(np.zeros((height, width, 3), np.float32), np.zeros((height, width), np.float32), 0.0)


def in_time(frame, state):
    """The frame, not before the last one: time does not go back where a camera does."""
    return replace(frame, timestamp=float(np.fmax(frame.timestamp, state.last_timestamp)))


def error(room, number, info):
    truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses[number]
    return np.linalg.norm(np.asarray(se3.matrix(info.T_world_cam))[:3, 3] - truth[:3, 3])


def test_black_frames_are_lost_and_the_rest_is_found(long_room, config):
    state, before = follow(slam.init(long_room.camera, config), long_room, range(0, 12, 3))
    state, dark = follow(state, long_room, [None] * 20)
    state, after = follow(state, long_room, range(15, 24, 3))
    assert all(info.tracked for info in before)
    assert not any(info.tracked for info in dark)
    assert state.num_lost == 20
    assert all(info.tracked for info in after)
    assert max(error(long_room, n, i) for n, i in zip(range(15, 24, 3), after, strict=True)) < 0.05
    assert len(state.trajectory) == len(before) + len(after)


@pytest.mark.parametrize(("num_dark", "found"), [(30, True), (31, False)])
def test_after_long_enough_the_surface_alone_finds_nothing(long_room, config, num_dark, found):
    """Nothing but keypoints, or a frame soon after, tells one place from another of the same shape."""
    state, _ = follow(slam.init(long_room.camera, config), long_room, range(0, 12, 3))
    state, dark = follow(state, long_room, [None] * num_dark)
    assert not any(info.tracked for info in dark)
    frame = in_time(long_room[9], state)
    _, unlit = slam.step(state, Frame(np.zeros_like(frame.rgb), frame.depth, frame.timestamp))
    assert unlit.tracked == found
    assert unlit.source == (PoseSource.SURFACE if found else PoseSource.LOST)
    _, lit = slam.step(state, frame)
    assert lit.tracked


@pytest.mark.parametrize(("angle", "tracked"), [(0.2, [0, 10, 20, 30, 40, 50]), (0.0, [0, 50])])
def test_without_keypoints_the_surface_is_searched_for_by_turned_guesses(long_room, config, angle, tracked):
    """Three times a second: the camera turns by up to 0.6 rad from frame to frame, and comes back."""
    features = replace(config.tracking.features, kind="none")
    # Three levels, for no keypoint helps GICP from so far away.
    tracking = replace(config.tracking, features=features, search_angle=angle, gicp=THREE_LEVELS)
    state = slam.init(long_room.camera, replace(config, tracking=tracking))
    numbers = range(0, 60, 10)
    _, infos = follow(state, long_room, numbers)
    found = {n: error(long_room, n, info) for n, info in zip(numbers, infos, strict=True) if info.tracked}
    assert list(found) == tracked
    assert max(found.values()) < 0.02


def test_after_a_jump_the_frame_is_found_among_all_keyframes(long_room, config):
    state, infos = follow(slam.init(long_room.camera, config), long_room, range(0, 30, 2))
    assert all(info.tracked for info in infos)
    assert len(state.graph.keyframes) > 2
    # Back from the far end of the swing to its beginning. Nothing of the last reference is in view, and no
    # camera gets there in no time. Five frames have to say so.
    numbers = range(0, 14, 2)
    state, after = follow(state, long_room, numbers)
    assert [info.tracked for info in after] == [False] * 4 + [True] * 3
    assert [info.relocalised for info in after] == [False] * 4 + [True] + [False] * 2
    assert max(error(long_room, n, i) for n, i in zip(numbers[4:], after[4:], strict=True)) < 0.05


def test_a_place_out_of_reach_that_one_keyframe_alone_shows_is_never_believed(long_room, config):
    config = replace(config, graph=replace(config.graph, relocalisation_candidates=1))
    state, _ = follow(slam.init(long_room.camera, config), long_room, range(0, 30, 2))
    _, after = follow(state, long_room, range(0, 14, 2))
    assert not any(info.tracked for info in after)


def test_within_reach_one_keyframe_is_enough(long_room, config):
    """The same jump, but in half a second: so far a camera may go."""
    config = replace(config, graph=replace(config.graph, relocalisation_candidates=1))
    state, _ = follow(slam.init(long_room.camera, config), long_room, range(0, 30, 2))
    later = replace(long_room[2], timestamp=state.last_timestamp + 0.5)
    _, info = slam.step(state, later)
    assert info.tracked
    assert info.relocalised
    assert error(long_room, 2, info) < 0.05


@pytest.fixture(scope="module")
def never(config):
    """Settings of tracking by which no frame wants to be a keyframe."""
    return replace(
        config.tracking,
        keyframe_inlier_fraction=0.0,
        keyframe_translation=10.0,
        keyframe_rotation=3.0,
        keyframe_margin=0.0,
    )


def test_a_keyframe_is_taken_while_the_keypoints_are_still_believed(long_room, config, never):
    """Nothing else asks for one. It comes by itself, before a frame needs the one before it as a bridge."""
    soon = replace(never, keyframe_margin=1.5)
    state, before = slam.init(long_room.camera, replace(config, tracking=soon)), None
    for number in range(0, 33, 2):
        state, info = slam.step(state, in_time(long_room[number], state), number=number)
        assert info.tracked
        if info.new_keyframe and number:
            assert info.num_inliers < 1.5 * soon.features.min_inliers_alone
            assert before.num_inliers >= 1.5 * soon.features.min_inliers_alone
            return
        before = info
    pytest.fail("no keyframe was taken")


def test_what_the_reference_no_longer_shows_is_found_by_way_of_the_frame_before(long_room, config, never):
    state = slam.init(long_room.camera, replace(config, tracking=never))
    numbers = range(0, 33, 2)
    state, infos = follow(state, long_room, numbers)
    assert all(info.tracked and not info.relocalised for info in infos)
    # No frame asked to be a keyframe, so the second is one that a later frame needed.
    assert not any(info.new_keyframe for info in infos[1:])
    assert len(state.graph.keyframes) > 1
    assert 0 < state.graph.keyframes[1].frame < len(numbers) - 1
    assert max(error(long_room, n, i) for n, i in zip(numbers, infos, strict=True)) < 0.05


@pytest.mark.parametrize("shared", [True, False])
def test_keypoints_that_leave_the_reference_go_on_from_the_frame_before(long_room, config, never, shared):
    """The reference's surface alone would do. So it does where the frame before had no keypoints either."""
    state, _ = follow(slam.init(long_room.camera, replace(config, tracking=never)), long_room, (0, 2, 4))
    unlike = np.random.default_rng(0).normal(
        size=state.tracker.references.keypoints.features.descriptors.shape
    )
    unlike /= np.linalg.norm(unlike, axis=-1, keepdims=True)
    source = PoseSource.JOINT if shared else PoseSource.SURFACE
    state = eqx.tree_at(
        lambda s: (s.tracker.references.keypoints.features.descriptors, s.tracker.last_registration.source),
        state,
        (jnp.asarray(unlike, jnp.float32), jnp.asarray(int(source), jnp.int32)),
    )
    state, (info,) = follow(state, long_room, (6,))
    assert info.source == source
    assert [keyframe.frame for keyframe in state.graph.keyframes] == ([0, 2] if shared else [0])
    assert error(long_room, 6, info) < 0.01


def test_a_first_frame_that_shows_nothing_starts_no_map(long_room, config):
    state, (info,) = follow(slam.init(long_room.camera, config), long_room, [None])
    assert not info.tracked
    assert not state.graph.keyframes
    state, (info,) = follow(state, long_room, [0])
    assert info.tracked
    np.testing.assert_allclose(se3.matrix(info.T_world_cam), np.eye(4))


def test_holes_in_depth_take_no_keyframes(long_room, config):
    """Half of each frame's depth is missing, other blocks each time. The camera moves by a centimetre."""
    rng = np.random.default_rng(0)
    state = slam.init(long_room.camera, config)
    for number in (0, 1, 0, 1, 0, 1):
        frame = in_time(long_room[number], state)
        kept = np.kron(rng.uniform(size=(15, 20)) > 0.5, np.ones((8, 8))) > 0
        state, info, _ = slam.follow(state, replace(frame, depth=np.where(kept, frame.depth, 0)))
        assert info.tracked
        assert error(long_room, number, info) < 0.01
    assert len(state.graph.keyframes) == 1
