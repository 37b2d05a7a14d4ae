"""Merging of two finished runs: one world, one map, and the frames of each recording told apart."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.arrays import InputError
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.geometry import read_tum, se3
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.state import (
    DepthInformation,
    TimingPrior,
    depth_prior,
    maps_of,
    no_depth_information,
    no_timing_information,
    rows_by_recording,
)
from sfgs_jax.splatting import load_ply, render, sh_to_rgb

FIRST, SECOND, THIRD = range(0, 20, 2), range(30, 8, -2), range(24, 34, 2)
ELSEWHERE = range(120, 126, 2)
"""Frames of a walk round a room. The second recording comes back to where the first ends."""


@pytest.fixture(scope="module")
def walk():
    return SyntheticRecording(num_frames=240, width=160, height=120)


@pytest.fixture(scope="module")
def config(config):
    return replace(config, graph=replace(config.graph, new_map_frames=3, map_support=2, loop_gap=3))


@pytest.fixture(scope="module")
def recorded(walk, config):
    """Makes the finished run of some frames, all of which have time stamps from 0 on."""

    def run(numbers, *, gain=(1.0, 1.0, 1.0)):
        state = slam.init(walk.camera, config)
        for place, number in enumerate(numbers):
            frame = walk[number]
            rgb = np.asarray(frame.rgb) * np.asarray(gain, np.float32)
            state, _ = slam.step(state, replace(frame, rgb=rgb, timestamp=place / 30))
        return slam.finish(state)

    return run


@pytest.fixture(scope="module")
def first(recorded):
    return recorded(FIRST)


@pytest.fixture(scope="module")
def second(recorded):
    return recorded(SECOND)


@pytest.fixture(scope="module")
def both(first, second):
    return slam.merge(first, second)


def truth(walk, numbers):
    """True poses in the world of the first recording."""
    return np.linalg.inv(walk.ground_truth.poses[FIRST[0]]) @ walk.ground_truth.poses[list(numbers)]


def test_the_second_recording_lies_in_the_world_of_the_first(both, first, second, walk):
    assert not maps_of(both.graph).any()
    assert len(both.graph.keyframes) == len(first.graph.keyframes) + len(second.graph.keyframes)
    rows = rows_by_recording(both.log)
    for numbers, own in zip((FIRST, SECOND), rows, strict=True):
        found = both.trajectory.poses[own]
        off = se3.logs_of(np.linalg.inv(truth(walk, numbers)) @ found)
        assert np.linalg.norm(off[:, :3], axis=1).max() < 0.01
        assert np.linalg.norm(off[:, 3:], axis=1).max() < 0.005
        deviations = np.sqrt(np.trace(both.covariances[own][:, :3, :3], axis1=1, axis2=2))
        assert np.linalg.norm(off[:, :3], axis=1).max() < 3 * deviations.max() < 0.05
    # The world frame is where it was.
    np.testing.assert_allclose(both.trajectory.poses[0], np.eye(4), atol=1e-5)


def test_frames_of_both_recordings_are_told_apart(both, first, second):
    rows = rows_by_recording(both.log)
    for state, own in zip((first, second), rows, strict=True):
        np.testing.assert_array_equal(both.log.timestamps[own], state.log.timestamps)
        shift = both.log.numbers[own] - state.log.numbers
        assert len(set(shift.tolist())) == 1
        # So that the same frames as before count as held out.
        assert shift[0] % 8 == 0
    frames = [keyframe.frame for keyframe in both.graph.keyframes]
    assert len(set(frames)) == len(frames)
    assert set(frames) | {view.frame for view in both.mapping.views} <= set(both.log.numbers.tolist())
    assert len(rows_by_recording(first.log)) == 1


def test_landmarks_and_edges_are_those_of_their_keyframes(both, first, second):
    count, placed = len(first.graph.keyframes), len(first.graph.landmarks)
    for old, new in zip(second.graph.keyframes, both.graph.keyframes[count:], strict=True):
        had = old.landmarks >= 0
        np.testing.assert_array_equal(new.landmarks[had], old.landmarks[had] + placed)
        assert new.reference == old.reference + count
    pairs = {(edge.target, edge.source) for edge in both.graph.edges}
    assert {(e.target + count, e.source + count) for e in second.graph.edges} <= pairs
    assert {(e.target, e.source) for e in first.graph.edges} <= pairs
    between = [edge for edge in both.graph.edges if edge.target < count <= edge.source]
    assert len(between) > count
    assert len(pairs) == len(both.graph.edges)


def test_signatures_are_those_of_their_keyframes(both):
    own = [np.asarray(keyframe.features.keypoints.signature) for keyframe in both.graph.keyframes]
    np.testing.assert_array_equal(both.graph.signatures, own)


def test_surface_that_both_maps_have_is_there_once(both, first, second, walk):
    count, parts = both.mapping.num_gaussians, (first.mapping.num_gaussians, second.mapping.num_gaussians)
    assert max(parts) < count < 0.8 * sum(parts)
    # From where the second recording began, which the first has not seen.
    depth, pose = np.asarray(walk[SECOND[0]].depth), truth(walk, SECOND)[0]
    maps = ((both.gaussians, pose), (first.gaussians, pose), (second.gaussians, np.eye(4)))
    drawn = [render(gaussians, walk.camera, T) for gaussians, T in maps]
    covered = [np.asarray(picture.alpha) > 0.5 for picture in drawn]
    assert covered[0].mean() > max(0.95, covered[1].mean() + 0.05)
    merged, alone = (
        np.median(np.abs(np.asarray(drawn[i].depth) - depth)[covered[i] & (depth > 0)]) for i in (0, 2)
    )
    assert merged < 1.2 * alone


def test_the_second_map_takes_the_exposure_of_the_first(both, first, recorded):
    gain = np.asarray([0.7, 0.8, 0.9])
    dark = slam.merge(first, recorded(SECOND, gain=gain))
    colours = []
    for state in (both, dark):
        added = np.asarray(state.mapping.map.keyframes) >= len(first.graph.keyframes)
        added &= np.asarray(state.gaussians.valid)
        colours.append(sh_to_rgb(np.asarray(state.gaussians.sh)[added, 0]).mean(axis=0))
    np.testing.assert_allclose(colours[1], colours[0], rtol=0.08)
    ratio = dark.mapping.views[-1].gain / both.mapping.views[-1].gain
    np.testing.assert_allclose(ratio, gain, rtol=0.08)


def test_states_that_were_merged_stay_as_they_were(both, first, second):
    assert len(first.graph.keyframes) + len(second.graph.keyframes) == len(both.graph.keyframes)
    np.testing.assert_array_equal(second.graph.poses[0], [1, 0, 0, 0, 0, 0, 0])
    assert second.graph.keyframes[0].frame == 0


def test_a_third_run_is_merged_with_the_result(both, recorded, walk):
    third = slam.merge(both, recorded(THIRD))
    rows = rows_by_recording(third.log)
    assert [len(own) for own in rows] == [len(FIRST), len(SECOND), len(THIRD)]
    off = third.trajectory.positions[rows[2]] - truth(walk, THIRD)[:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 0.02


def test_maps_of_the_first_run_become_one_through_the_second(recorded, walk):
    """The first run has two, with a jump between them; the second walks from one to the other."""
    apart, way = [*range(0, 10, 2), *range(192, 213, 3)], [*range(201, 240, 3), *range(0, 8, 2)]
    state = recorded(apart)
    assert len(slam.Run(state).maps) == 2
    merged = slam.merge(state, recorded(way))
    (whole,) = slam.Run(merged).maps
    lost = 2
    assert [len(part.rows) for part in whole.recordings] == [len(apart) - lost, len(way)]
    for part, numbers in zip(whole.recordings, (apart, way), strict=True):
        places = np.round(30 * part.trajectory.timestamps).astype(int)
        off = part.trajectory.positions - truth(walk, np.asarray(numbers)[places])[:, :3, 3]
        assert np.linalg.norm(off, axis=1).max() < 0.02


def test_another_recording_goes_on_in_the_result(both, walk):
    """The first frames are lost, until several in a row are recognised."""
    state, found = slam.new_session(both), []
    numbers = range(28, 8, -2)
    for place, number in enumerate(numbers):
        state, info = slam.step(state, replace(walk[number], timestamp=place / 30))
        found.append(info.tracked)
    assert found == [False] * 4 + [True] * 6
    off = state.trajectory.positions - truth(walk, numbers)[4:, :3, 3]
    assert np.linalg.norm(off, axis=1).max() < 0.02


def test_a_merged_run_is_written_and_read(both, walk, tmp_path):
    result = slam.Run(both, num_frames=len(FIRST) + len(SECOND), is_finished=True)
    assert len(result.maps) == 1
    slam.write_run(result, tmp_path)
    names = ("trajectory.txt", "trajectory_recording_2.txt")
    for name, numbers, rows in zip(names, (FIRST, SECOND), rows_by_recording(both.log), strict=True):
        written = read_tum(tmp_path / name)
        np.testing.assert_allclose(written.timestamps, np.arange(len(numbers)) / 30, atol=1e-6)
        np.testing.assert_allclose(written.positions, both.trajectory.positions[rows], atol=1e-5)
    assert len(read_tum(tmp_path / "keyframes_recording_2.txt")) > 2
    assert not (tmp_path / "trajectory_2.txt").exists()
    assert len(load_ply(tmp_path / "map.ply").means) == both.mapping.num_gaussians
    slam.save_run(result, tmp_path / "state")
    again = slam.load_run(tmp_path / "state", both.config, walk.camera).state
    np.testing.assert_array_equal(again.trajectory.poses, both.trajectory.poses)
    np.testing.assert_array_equal(again.gaussians.means, both.gaussians.means)
    # Another run's files do not stay behind.
    slam.prepare_folder(tmp_path, overwrite=True)
    assert not list(tmp_path.iterdir())


def test_a_merged_map_is_refined(both):
    config = replace(both.config, mapping=replace(both.config.mapping, final_steps=2))
    result = slam.Run(replace(both, config=config), is_finished=True)
    slam.refine(result)
    assert result.num_refined == 2
    assert result.state.mapping.num_steps == both.mapping.num_steps + 2


def test_gains_and_corrections_do_not_reach_into_another_recording(both, first):
    """By time alone, the views of the second recording would be among those of the first."""
    views = tuple(
        replace(view, correction=np.full(6, 0.01 * (view.frame >= 100), np.float32))
        for view in both.mapping.views
    )
    moved = replace(both, mapping=replace(both.mapping, views=views)).trajectory
    rows = rows_by_recording(both.log)
    np.testing.assert_array_equal(moved.poses[rows[0]], both.trajectory.poses[rows[0]])
    assert np.abs(moved.poses[rows[1]] - both.trajectory.poses[rows[1]]).max() > 0.005


def test_without_a_common_place_nothing_is_merged(first, recorded):
    with pytest.raises(InputError, match="No place of the second run was recognised"):
        slam.merge(first, recorded(ELSEWHERE))


def test_states_that_do_not_fit_are_refused(first, second, walk, config):
    with pytest.raises(InputError, match="second run has no keyframes"):
        slam.merge(first, slam.init(walk.camera, config))
    with pytest.raises(InputError, match="first run has no keyframes"):
        slam.merge(slam.init(walk.camera, config), second)
    camera = replace(walk.camera, fx=walk.camera.fx + 1)
    with pytest.raises(InputError, match="different cameras"):
        slam.merge(first, replace(second, params=replace(second.params, camera=camera)))
    other = replace(config, graph=replace(config.graph, window=5))
    with pytest.raises(InputError, match="different settings"):
        slam.merge(first, replace(second, config=other))
    without = replace(config, graph=replace(config.graph, loops=False))
    with pytest.raises(InputError, match="without loops"):
        slam.merge(*(replace(state, config=without) for state in (first, second)))
    for pair in ((first, first), (first, slam.new_session(first)), (slam.new_session(first), first)):
        with pytest.raises(InputError, match="both are in one world already"):
            slam.merge(*pair)
    # The refinement after the last frame may differ.
    longer = replace(config, mapping=replace(config.mapping, final_steps=7))
    assert slam.merge(first, replace(second, config=longer)).config == config


def test_what_registrations_told_about_depth_adds_up(rng):
    """Whatever each of the two sums started from."""
    prior = depth_prior((6, 8), 0.01, 0.01, 0.01)
    size = len(prior.information)
    start = no_depth_information(np.zeros(size))
    true, told = 0.01 * rng.standard_normal(size), []
    for begun in (np.zeros(size), 0.02 * rng.standard_normal(size)):
        root = rng.standard_normal((size, size))
        information = 1e6 * root @ root.T
        told.append(DepthInformation(begun, information, information @ (true - begun), 1.0, 2.0))
    found = told[0].joined(told[1])
    np.testing.assert_allclose(found.estimate(prior), true, atol=1e-4)
    np.testing.assert_array_equal(found.start, start.start)
    assert (found.chi_square, found.expected) == (2.0, 4.0)


def test_what_registrations_told_about_the_times_of_rows_adds_up(rng):
    """Whatever each of the two sums was counted from, and what they told of depth's errors."""
    true, starts = 0.02 * rng.standard_normal(5), 0.02 * rng.standard_normal((2, 5))
    prior = TimingPrior(jnp.ones(3), jnp.eye(2))
    told = []
    for start in starts:
        root = rng.standard_normal((5, 5))
        information = 1e6 * (root @ root.T + np.eye(5))
        vector = jnp.asarray(information @ (true - start), jnp.float32)
        none = no_timing_information(2, np.dtype(np.float32))
        told.append(none.plus(jnp.asarray(information, jnp.float32), vector, prior))
    found = told[0].joined(told[1].counted_from(starts[0] - starts[1]), prior)
    np.testing.assert_allclose(found.most_likely, true - starts[0], atol=1e-4)
    estimate = found.estimate(SensorTiming.of_vector(jnp.asarray(starts[0, :3], jnp.float32)))
    np.testing.assert_allclose(estimate.vector, true[:3], atol=1e-4)
    np.testing.assert_allclose(found.expected, told[0].expected + told[1].expected)
