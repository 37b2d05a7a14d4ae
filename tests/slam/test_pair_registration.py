"""Pairs of keyframes, registered while a frame is tracked: the same as at once, unless the graph changed."""

import threading
from dataclasses import fields, replace

import jax
import numpy as np
import pytest
from short_runs import run_of_five_keyframes

from sfgs_jax import slam
from sfgs_jax.slam.keyframes import Registrations, advance_graph, rectified_anew, registered_pairs
from sfgs_jax.slam.state import KeyframeGraph


@pytest.fixture(scope="module")
def run(room, frames, config):
    return run_of_five_keyframes(room, frames, config)


@pytest.fixture(scope="module")
def waiting(run):
    """Its graph with two pairs that wait, one of them to be registered anew."""
    pairs = [(edge.target, edge.source) for edge in run.graph.edges]
    first = pairs[0]
    second = next(pair for pair in pairs if first[1] not in pair)
    return replace(run.graph, tracked=(), pending=(first,), again=(second,))


@pytest.fixture(scope="module")
def both(config):
    """Settings by which a frame takes two registrations."""
    return replace(config.graph, registrations_per_frame=2)


def with_other_features(graph, number):
    """The graph with a keyframe's features rectified anew: equal ones, but others."""
    keyframes = list(graph.keyframes)
    copied = jax.tree.map(lambda x: x.copy(), keyframes[number].features)
    keyframes[number] = replace(keyframes[number], features=copied)
    return replace(graph, keyframes=tuple(keyframes))


def test_begun_before_the_frame_they_give_the_same_graph(run, waiting, both):
    registrations = Registrations()
    registrations.begin(run.params, waiting, both)
    begun = registrations.take()
    beside, _ = advance_graph(run.params, waiting, both, grown=False, registered=begun)
    at_once, _ = advance_graph(run.params, waiting, both, grown=False)
    assert (beside.pending, beside.again) == ((), ())
    assert len(beside.edges) == len(waiting.edges)
    for a, b in zip(beside.edges, at_once.edges, strict=True):
        np.testing.assert_array_equal(a.T_target_source, b.T_target_source)
        np.testing.assert_array_equal(a.information, b.information)


def test_a_frame_that_does_not_wait_takes_them_once_they_are_there(run, waiting, both):
    released = threading.Event()

    class HeldBack(KeyframeGraph):
        """A graph whose registrations begin only when they may."""

        def __getattribute__(self, name):
            assert name != "pending" or released.wait(60)
            return super().__getattribute__(name)

    registrations = Registrations(are_awaited=False)
    assert registrations.take() == ()
    held = HeldBack(**{field.name: getattr(waiting, field.name) for field in fields(waiting)})
    registrations.begin(run.params, held, both)
    registrations.begin(run.params, run.graph, both)  # others are under way
    assert registrations.take() == ()
    released.set()
    while not (found := registrations.take()):
        pass
    assert [(pair.target, pair.source) for pair in found] == [*waiting.pending, *waiting.again]
    assert registrations.take() == ()


def test_one_pair_is_registered_while_the_tracker_is_idle(run, waiting, both):
    registrations = Registrations(are_awaited=False)
    registrations.begin_while_idle(run.params, waiting, both)
    while not (found := registrations.take()):
        pass
    assert [(pair.target, pair.source) for pair in found] == [(*waiting.pending, *waiting.again)[0]]


def test_a_frame_that_comes_at_once_lets_no_registration_begin(run, waiting, both):
    registrations = Registrations(are_awaited=False, patience=60.0)
    registrations.begin_while_idle(run.params, waiting, both)
    registrations.frame_came()
    while not (found := registrations.take()):
        registrations.begin(run.params, waiting, both)
    assert len(found) == 2  # those of the other call, not the one of idle time


def test_a_frame_that_waits_without_any_begun_registers_itself(run, waiting, both):
    assert Registrations().take() is None
    after, _ = advance_graph(run.params, waiting, both, grown=False, registered=())
    assert (after.pending, after.again) == (waiting.pending, waiting.again)


def test_as_many_are_registered_as_it_is_the_turn_of(run, waiting, config):
    pairs = [(edge.target, edge.source) for edge in run.graph.edges]
    settings = replace(config.graph, registrations_per_frame=1, backlog=2)
    for count, turn in ((0, 0), (1, 1), (2, 1), (4, 2)):
        graph = replace(waiting, pending=tuple(pairs[:count]), again=())
        found = registered_pairs(run.params, graph, settings)
        assert [(pair.target, pair.source) for pair in found] == pairs[:turn]


def test_a_pair_whose_features_changed_meanwhile_keeps_its_place(run, waiting, both):
    begun = registered_pairs(run.params, waiting, both)
    changed = with_other_features(waiting, waiting.pending[0][1])
    after, _ = advance_graph(run.params, changed, both, grown=False, registered=begun)
    assert after.pending == waiting.pending
    assert after.again == ()
    after, _ = advance_graph(run.params, after, both, grown=False)
    assert after.pending == ()


def test_the_frame_after_a_keyframe_hears_what_it_was_tracked_by(run, config):
    (tracked,) = run.graph.tracked
    before = run.graph.edges
    (number,) = [i for i, e in enumerate(before) if (e.target, e.source) == (tracked.target, tracked.source)]
    assert not before[number].told
    after, _ = advance_graph(run.params, replace(run.graph, pending=(), again=()), config.graph, grown=False)
    assert after.tracked == ()
    assert [edge.told for edge in after.edges] == [edge.told or i == number for i, edge in enumerate(before)]
    np.testing.assert_array_equal(after.edges[number].T_target_source, before[number].T_target_source)
    assert after.focal.information > run.graph.focal.information


def test_a_keyframe_that_is_registered_anew_is_not_heard_before(run, config):
    (tracked,) = run.graph.tracked
    times = np.full(3, 0.5, np.float32)
    keyframes = tuple(replace(k, twist=np.ones(6, np.float32)) for k in run.graph.keyframes)
    after = rectified_anew(run.params, replace(run.graph, keyframes=keyframes), times, config.graph)
    assert (tracked.target, tracked.source) in after.again
    assert after.tracked == ()


def test_two_maps_that_became_one_are_registered_by_their_poses(run, waiting, both):
    target, source = waiting.pending[0]
    keyframes = list(waiting.keyframes)
    keyframes[source] = replace(keyframes[source], reference=source)
    apart = replace(waiting, keyframes=tuple(keyframes), edges=(), num_absorbed=0, again=())
    (pair,) = registered_pairs(run.params, apart, both)
    assert pair.are_apart
    assert pair.holds(apart)
    assert not pair.holds(waiting)
    (pair,) = registered_pairs(run.params, replace(waiting, again=()), both)
    assert not pair.are_apart
    assert (pair.target, pair.source) == (target, source)


def test_a_frame_takes_what_was_begun_before_it(run, frames):
    """Pairs that a frame brings wait for the next frame."""
    pairs = tuple((edge.target, edge.source) for edge in run.graph.edges[1:2])
    state = replace(run, graph=replace(run.graph, pending=pairs, again=()))
    state, info = slam.step(state, frames[10], number=5)
    assert info.tracked
    assert not info.new_keyframe
    assert state.graph.pending == ()
    assert (state.graph.edges[-1].target, state.graph.edges[-1].source) == pairs[0]


def test_a_frame_after_a_lost_one_registers_at_once(run, frames):
    pairs = tuple((edge.target, edge.source) for edge in run.graph.edges[1:2])
    state = replace(run, graph=replace(run.graph, pending=pairs, again=()))
    black = replace(frames[10], rgb=np.zeros_like(frames[10].rgb), depth=np.zeros_like(frames[10].depth))
    state, info = slam.step(state, black, number=5)
    assert not info.tracked
    assert state.graph.pending == pairs
    state, info = slam.step(state, frames[10], number=6)
    assert info.tracked
    assert state.graph.pending == ()
