"""Several maps: one begins where a lost camera sees an unknown place, and they become one where both meet."""

import json
from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.datasets import SyntheticRecording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Frame, Trajectory, read_tum, se3
from sfgs_jax.slam.frontend import NO_SUSPICION, frames_until_new_map
from sfgs_jax.slam.keyframes import loop_pairs, merged, neighbours, optimise_poses, prior_noise
from sfgs_jax.slam.state import Edge, Keyframe, empty_graph, frames_by_map, maps_of
from sfgs_jax.splatting import load_ply

IDENTITY = np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32)
FIRST_PART, SECOND_PART = list(range(0, 12, 2)), [*range(180, 240, 3), *range(0, 10, 2)]
"""Frames of a walk round a room: its beginning, and after a jump its end, which leads back there."""


@pytest.fixture(scope="module")
def walk():
    return SyntheticRecording(num_frames=240, width=160, height=120)


def _frames(walk, numbers):
    frames = [walk[number] for number in numbers]
    return [Frame(f.rgb, f.depth, place / 30) for place, f in enumerate(frames)]


def _true(walk, numbers, times):
    """The true poses at the time stamps of the frames that were tracked."""
    places = np.round(30 * times).astype(int)
    return Trajectory(times, walk.ground_truth.poses[np.asarray(numbers)[places]])


@pytest.fixture(scope="module")
def config(config):
    return replace(config, graph=replace(config.graph, new_map_frames=3, map_support=2, loop_gap=3))


@pytest.fixture(scope="module")
def runs(walk, config):
    """Runs that end before the maps meet, and after."""
    state, infos, halfway = slam.init(walk.camera, config), [], None
    for number, frame in enumerate(_frames(walk, FIRST_PART + SECOND_PART)):
        state, info = slam.step(state, frame)
        infos.append(info)
        if number == 15:
            halfway = slam.finish(state)
    assert halfway is not None
    return slam.Run(halfway), slam.Run(slam.finish(state)), infos


def test_a_place_that_nobody_knows_begins_another_map(runs, walk):
    run, _, infos = runs
    begun = len(FIRST_PART) + 2  # with the third frame that fits nowhere
    assert [info.tracked for info in infos[begun - 2 : begun + 1]] == [False, False, True]
    assert [number for number, info in enumerate(infos) if info.new_map] == [begun]
    assert infos[begun].new_keyframe
    assert [len(part.rows) for part in run.maps] == [8, 6]
    for part in run.maps:
        found = part.trajectory
        np.testing.assert_allclose(found.poses[0], np.eye(4), atol=1e-5)
        assert ate(found, _true(walk, FIRST_PART + SECOND_PART, found.timestamps)).rmse_m < 0.01
        # The deviations are those within the map.
        assert np.sqrt(np.trace(part.covariances[:, :3, :3], axis1=1, axis2=2)).max() < 0.1


@pytest.mark.parametrize(
    ("at", "new_map_frames", "expected"), [(1, 30, 10), (2, 30, 5), (1, 8, 8), (2, 0, 0), (-1, 30, 30)]
)
def test_a_small_map_is_left_sooner(runs, walk, config, at, new_map_frames, expected):
    """Keyframes 0 and 1 are one map, 2 is another; -1 is a new session, whose camera may be in any map."""
    graph = _graph(runs, [0, 0, 2], [0, 1, 100])
    tracker = slam.init(walk.camera, config).tracker
    tracker = replace(tracker, reference_keyframes=jnp.full_like(tracker.reference_keyframes, at))
    waits = slam.GraphConfig(new_map_frames=new_map_frames, relocalisation_frames=5)
    assert frames_until_new_map(tracker, graph, waits) == expected


def test_maps_become_one_where_they_meet(runs, walk):
    _, run, infos = runs
    (whole,) = run.maps
    assert len(whole.rows) == len(FIRST_PART + SECOND_PART) - 2
    assert any(info.loop_closed for info in infos[-5:])
    found = run.trajectory
    assert ate(found, _true(walk, FIRST_PART + SECOND_PART, found.timestamps)).rmse_m < 0.02
    off = infos[-1].T_world_cam.translation() - found.poses[-1][:3, 3]
    assert np.linalg.norm(off) < 0.1


def test_each_map_has_its_own_files(runs, tmp_path):
    apart, one, _ = runs
    slam.write_run(apart, tmp_path)
    for number, part in enumerate(apart.maps, start=1):
        name = "" if number == 1 else f"_{number}"
        written = read_tum(tmp_path / f"trajectory{name}.txt")
        np.testing.assert_allclose(written.timestamps, part.trajectory.timestamps, atol=1e-6)
        gaussians = load_ply(tmp_path / f"map{name}.ply")
        assert len(gaussians.means) == np.asarray(part.gaussians.valid).sum() > 1000
        # In the world of its own first camera, which stands in the room.
        assert np.abs(np.asarray(gaussians.means)).max() < 10
    counts = json.loads((tmp_path / "metrics.json").read_text())
    assert counts["map"]["number"] == 2
    assert counts["frames"]["tracked"] == 8
    assert counts["frames"]["in_other_maps"] == 6
    slam.write_run(one, tmp_path)
    assert not list(tmp_path.glob("*_2.*"))


def test_dark_frames_begin_no_map(walk, config):
    state = slam.init(walk.camera, config)
    for frame in _frames(walk, FIRST_PART):
        state, _ = slam.step(state, frame)
    for number in range(8):
        dark = Frame(np.zeros((120, 160, 3), np.float32), np.zeros((120, 160), np.float32), 1 + number / 30)
        state, info = slam.step(state, dark)
        assert not info.tracked
        assert not info.new_map
    assert int(state.tracker.suspicion.unknown) == int(NO_SUSPICION.unknown)


def _graph(runs, references, places):
    """A graph of keyframes that were tracked in others, at places along x."""
    template = runs[0].state.graph.keyframes[0]
    poses = np.tile(IDENTITY, (len(places), 1))
    poses[:, 4] = places
    keyframes = tuple(
        Keyframe(**(vars(template) | {"frame": number, "reference": reference}))
        for number, reference in enumerate(references)
    )
    covariances = 1e-4 * np.arange(len(places))[:, None, None] * np.eye(6)
    graph = empty_graph(np.zeros(0), prior_noise(slam.GraphConfig()), 1)
    signatures = np.tile(np.asarray(template.features.keypoints.signature), (len(places), 1))
    return replace(
        graph,
        keyframes=keyframes,
        poses=poses,
        covariances=covariances,
        depth_sensitivities=np.zeros((len(places), 6, 0)),
        signatures=signatures,
    )


def _edge(target, source, shift, deviation=0.01):
    motion = np.asarray([1, 0, 0, 0, shift, 0, 0], np.float32)
    information = np.eye(6, dtype=np.float32) / deviation**2
    offsets = np.zeros(0), np.zeros((6, 0)), np.zeros((6, 0))
    return Edge(target, source, motion, information, motion, information, False, True, *offsets)


def test_maps_are_what_references_and_edges_tie(runs):
    graph = _graph(runs, [0, 0, 2, 2, 3, 5], [0, 1, 100, 101, 102, 200])
    np.testing.assert_array_equal(maps_of(graph), [0, 0, 2, 2, 2, 5])
    tied = replace(graph, edges=(_edge(1, 5, 1.0),))
    np.testing.assert_array_equal(maps_of(tied), [0, 0, 2, 2, 2, 0])
    log = runs[0].state.log
    log = replace(log, keyframes=np.resize([2, 0, 4, 3], len(log.keyframes)))
    (first, rows), (other, _) = frames_by_map(log, graph)
    assert (first, other) == (2, 0)
    np.testing.assert_array_equal(rows, np.flatnonzero(np.arange(len(log.keyframes)) % 4 != 1))


def test_a_merged_map_lies_where_the_edge_puts_it(runs):
    """Keyframe 3 of the later map is half a metre ahead of keyframe 1: the whole map comes to lie there."""
    graph = _graph(runs, [0, 0, 2, 2, 3], [0, 1, 100, 101, 102])
    found = merged(graph, maps_of(graph), [_edge(1, 3, 0.5)])
    np.testing.assert_allclose(found.poses[:, 4], [0, 1, 0.5, 1.5, 2.5], atol=1e-5)
    assert not maps_of(found).any()
    # Keyframes 1 and 3, the edge, and the motion from 3 to 4 each add their covariance.
    noise = found.noise.covariance[0, 0]
    np.testing.assert_allclose(found.covariances[3][0, 0], 1e-4 + 1e-4 + noise + 3e-4 + 3e-4, rtol=1e-3)
    np.testing.assert_array_equal(found.covariances[:2], graph.covariances[:2])
    # The other way round the edge says the same.
    back = merged(graph, maps_of(graph), [_edge(3, 1, -0.5)])
    np.testing.assert_allclose(back.poses, found.poses, atol=1e-5)


def test_each_map_keeps_its_first_keyframe(runs):
    graph = _graph(runs, [0, 0, 2, 2], [0, 1, 100, 101])
    edges = (replace(_edge(0, 1, 0.9), loop=False), replace(_edge(2, 3, 1.2), loop=False))
    found = optimise_poses(replace(graph, edges=edges), slam.GraphConfig(capacity=16))
    np.testing.assert_allclose(found.poses[:, 4], [0, 0.9, 100, 101.2], atol=1e-3)


def test_keyframes_of_another_map_are_loops_and_no_neighbours(runs):
    graph = _graph(runs, [0, 0, 2], [0, 1, 1])
    config = slam.GraphConfig(loop_gap=10)
    assert neighbours(graph, config) == ()
    assert {pair[0] for pair in loop_pairs(graph, config)} == {0, 1}
    assert neighbours(_graph(runs, [0, 0, 1], [0, 1, 1]), config) != ()


def test_the_pose_of_a_map_s_first_frame_is_where_it_begins(runs):
    _, _, infos = runs
    first = next(info for info in infos if info.new_map)
    assert isinstance(first.T_world_cam, jaxlie.SE3)
    np.testing.assert_allclose(se3.matrix(first.T_world_cam)[:3, :3], np.eye(3), atol=1e-6)
    assert float(first.T_world_cam.translation()[0]) >= 50
