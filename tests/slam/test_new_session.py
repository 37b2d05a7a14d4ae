"""Another recording in the map of one before."""

from dataclasses import replace

import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import is_held_out, se3


@pytest.fixture(scope="module")
def before(room, frames, config):
    """The state after a recording with several keyframes and views."""
    state = slam.init(room.camera, config)
    for number, frame in enumerate(frames):
        state, _ = slam.step(state, frame, number=number)
    return state


def truth(room, number):
    return np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses[number]


def test_another_recording_finds_itself_in_the_map(before, room, frames):
    """Backwards, on another day: five frames are recognised before the first is believed."""
    state, infos = slam.new_session(before), []
    numbers = list(range(11, -1, -1))
    for new, old in enumerate(numbers):
        state, info = slam.step(state, replace(frames[old], timestamp=float(new)))
        infos.append(info)
    assert [info.tracked for info in infos] == [False] * 4 + [True] * 8
    assert infos[4].relocalised
    for old, info in zip(numbers[4:], infos[4:], strict=True):
        found = np.asarray(se3.matrix(info.T_world_cam))
        assert np.linalg.norm(found[:3, 3] - truth(room, old)[:3, 3]) < 0.02
    np.testing.assert_array_equal(state.log.numbers, np.arange(4, 12))
    np.testing.assert_array_equal(state.trajectory.timestamps, np.arange(4.0, 12.0))
    after = slam.finish(state)
    ends = np.stack([truth(room, old) for old in numbers[4:]])[:, :3, 3]
    assert np.linalg.norm(after.trajectory.positions - ends, axis=1).max() < 0.02


def test_the_map_is_as_it_was(before):
    state = slam.new_session(before)
    assert state.mapping.num_gaussians == before.mapping.num_gaussians
    assert len(state.graph.keyframes) == len(before.graph.keyframes) > 2
    assert len(state.trajectory) == state.num_lost == state.next_frame == 0
    pairs = [
        (old.frame, new.frame)
        for olds, news in (
            (before.graph.keyframes, state.graph.keyframes),
            (before.mapping.views, state.mapping.views),
        )
        for old, new in zip(olds, news, strict=True)
    ]
    assert len({old - new for old, new in pairs}) == 1
    # Not the number before the first: that would be the frame before it.
    assert max(new for _, new in pairs) < -1
    assert all(is_held_out(old) == is_held_out(new) for old, new in pairs)


def test_a_session_may_refine_its_map_longer_but_not_track_otherwise(before, config):
    longer = replace(config, mapping=replace(config.mapping, final_steps=7))
    assert slam.new_session(before, longer).config == longer
    other = replace(config, graph=replace(config.graph, window=5))
    with pytest.raises(InputError, match="made with other settings"):
        slam.new_session(before, other)


def test_without_keyframes_there_is_no_place_to_go_on_in(room, config):
    with pytest.raises(InputError, match="without keyframes"):
        slam.new_session(slam.init(room.camera, config))
