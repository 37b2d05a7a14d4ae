"""Mapping beside tracking, on the recording's own clock."""

import time
from collections.abc import Callable
from dataclasses import replace
from threading import Event
from typing import Any

import numpy as np
import pytest

from sfgs_jax import Camera, Frame, slam
from sfgs_jax.datasets import play
from sfgs_jax.slam import Stopwatch, follow
from sfgs_jax.slam.mapping import Allowance, ThreadedMapWorker
from sfgs_jax.slam.run import spill_views
from sfgs_jax.slam.state import MapState


def worker(
    state: slam.SlamState, spill: Callable[[MapState], MapState] = lambda mapping: mapping, **settings: Any
) -> ThreadedMapWorker:
    return ThreadedMapWorker(state, Stopwatch(), spill, **settings)


def test_the_mapper_learns_and_optimises_until_it_is_stopped(room, frames, config):
    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state)
    mapper.learn(state, view)
    _wait(lambda: mapper.mapping.num_steps >= 3)
    mapping = mapper.stop()
    assert mapping.num_steps >= 3
    assert [view.frame for view in mapping.views] == [0]
    assert mapping.num_gaussians > 100
    np.testing.assert_array_equal(mapping.keyframe_poses, state.graph.poses)


def test_the_mapper_works_only_while_a_frame_is_waited_for(room, frames, config):
    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state)
    source = mapper.frames(frames[:2])
    next(source)
    mapper.learn(state, view)
    time.sleep(0.5)
    assert mapper.mapping.num_steps == 0
    assert not mapper.mapping.views
    next(source)
    assert next(source, None) is None
    _wait(lambda: mapper.mapping.num_steps >= 2)
    assert len(mapper.stop().views) == 1


def test_frames_that_are_there_already_leave_the_mapper_no_time(room, frames, config):
    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state, patience=1.0)
    source = mapper.frames(frames[:1] * 20)
    next(source)
    mapper.learn(state, view)
    for _ in source:
        time.sleep(0.01)
        assert not mapper.mapping.views
    _wait(lambda: bool(mapper.mapping.views))
    assert len(mapper.stop().views) == 1


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_a_share_of_the_frames_may_be_late(share):
    allowance, late = Allowance(share), []
    for _ in range(1000):
        late.append(allowance.is_left)
        allowance.frame_came(late=late[-1])
    assert late[0]
    assert share <= np.mean(late) < share + 0.01
    assert np.diff(np.flatnonzero(late[10:])).max() <= 1 / share + 1


def test_frames_in_time_take_nothing_from_the_allowance():
    allowance = Allowance(0.05)
    for late in [True, *[False] * 40, True]:
        assert allowance.is_left
        allowance.frame_came(late=late)


def test_the_mapper_waits_after_frames_were_late_beside_it(room, frames, config):
    begun, ended = Event(), Event()

    def spill(mapping: MapState) -> MapState:
        begun.set()
        assert ended.wait(120)
        return mapping

    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state, spill=spill)
    mapper.learn(state, view)
    assert begun.wait(120)
    for _ in mapper.frames(frames[:1] * 4):  # each is there at once: three were late
        pass
    ended.set()
    _wait(lambda: bool(mapper.mapping.views))
    time.sleep(0.5)
    assert mapper.mapping.num_steps == 0
    assert len(mapper.stop().views) == 1


def test_keyframes_come_first_and_then_the_other_views(room, frames, config):
    state, _, keyframe = follow(slam.init(room.camera, config), frames[0])
    assert keyframe is not None
    mapper = worker(state)
    for _ in mapper.frames(frames[:1]):
        for number in (1, 2, 3):
            mapper.learn(state, replace(keyframe, frame=number))
        mapper.learn(state, keyframe)
        mapping = mapper.stop()
        assert [view.frame for view in mapping.views] == [0, 1, 2, 3]


def test_many_views_are_not_kept_waiting(room, frames, config):
    config = replace(config, mapping=replace(config.mapping, views_in_memory=2))
    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state)
    for _ in mapper.frames(frames[:1]):
        for _ in range(4):
            mapper.learn(state, view)
        _wait(lambda: len(mapper.mapping.views) >= 2)
        assert len(mapper.mapping.views) == 2
    mapper.stop()


def test_the_mapper_keeps_images_of_old_views_on_disk(room, frames, config, tmp_path):
    config = replace(config, mapping=replace(config.mapping, views_in_memory=1))
    state, _, view = follow(slam.init(room.camera, config), frames[0])
    assert view is not None
    mapper = worker(state, spill=lambda mapping: spill_views(mapping, tmp_path, 1))
    mapper.learn(state, view)
    mapper.learn(state, replace(view, frame=1))
    first, second = mapper.stop().views
    assert isinstance(first.rgb, np.memmap)
    assert not isinstance(second.rgb, np.memmap)
    np.testing.assert_array_equal(first.rgb, view.rgb)


def test_what_ends_the_mapper_reaches_its_owner(room, frames, config):
    def fail(mapping: MapState) -> MapState:
        raise RuntimeError("no room")

    state, _, view = follow(slam.init(room.camera, config), frames[0])
    mapper = worker(state, spill=fail)
    mapper.learn(state, view)
    with pytest.raises(RuntimeError, match="no room"):
        mapper.stop()


def _wait(until: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 120
    while not until() and time.monotonic() < deadline:
        time.sleep(0.01)


class Slow:
    """A recording of ten frames, a hundredth of a second apart."""

    name = dataset = "slow"
    camera = Camera(1.0, 1.0, 0.5, 0.5, width=1, height=1)
    ground_truth = None
    notes = ()
    timestamps = np.arange(10) / 100

    def __len__(self):
        return 10

    def __getitem__(self, index):
        return Frame(np.zeros((1, 1, 3), np.float32), np.ones((1, 1), np.float32), float(index))


def test_frames_that_nobody_was_ready_for_are_left_out():
    class Watched(Slow):
        decoded = -1
        first_taken = Event()

        def __getitem__(self, index):
            assert index == 0 or self.first_taken.wait(120)
            self.decoded = index
            return super().__getitem__(index)

    taken = []
    recording: Any = Watched()
    for number, frame in play(recording):
        assert isinstance(frame, Frame)
        assert number == frame.timestamp
        taken.append(number)
        recording.first_taken.set()
        # The frame before the one being decoded has been put there: the next one of ours is gone.
        _wait(lambda: recording.decoded >= min(taken[-1] + 3, 9))
    assert taken[0] == 0
    assert taken[-1] == 9
    assert np.all(np.diff(taken) >= 1)
    assert len(taken) <= 6  # 0, 2, 4, 6, 8, 9 at most


def test_a_consumer_that_is_fast_gets_every_frame():
    recording: Any = Slow()
    recording.timestamps = np.arange(10) / 3  # slow enough for a machine that does other work too
    assert [number for number, _ in play(recording, first=4)] == [4, 5, 6, 7, 8, 9]


def test_a_wrong_stamp_is_not_waited_for():
    recording: Any = Slow()
    recording.timestamps = np.array([*np.arange(9) / 10, 1e12])
    assert [number for number, _ in play(recording, first=6)][-1] == 9


def test_what_ends_the_decoder_is_raised():
    class Broken(Slow):
        def __getitem__(self, index):
            if index == 2:
                raise RuntimeError("unplugged")
            return super().__getitem__(index)

    recording: Any = Broken()
    with pytest.raises(RuntimeError, match="unplugged"):
        list(play(recording))


def test_a_run_in_real_time_tracks_and_maps(room, frames, config):
    numbered = [(i, frame) for i, frame in enumerate(frames) if i not in (4, 5)]
    config = replace(config, mapping=replace(config.mapping, steps_per_view=1))
    result = slam.run(iter(numbered), room.camera, config, realtime=True)
    assert result.num_dropped == 2
    assert result.num_frames == len(frames)
    assert len(result.trajectory) == len(frames) - 2
    assert result.state.mapping.num_steps > config.mapping.final_steps
    assert result.num_refined == config.mapping.final_steps
    truth = np.linalg.inv(room.ground_truth.poses[0]) @ room.ground_truth.poses
    kept = [i for i, _ in numbered]
    np.testing.assert_allclose(result.trajectory.positions, truth[kept, :3, 3], atol=0.03)
    assert np.all(np.diff(result.keyframe_trajectory.timestamps) > 0)
