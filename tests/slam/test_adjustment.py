"""Adjustment of keyframes and landmarks: what it is made of, when its results are taken, where it ends."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from registrations import registration
from short_runs import run_of_five_keyframes

from sfgs_jax import slam
from sfgs_jax.factor_graph import RelativePose, RgbdReprojection
from sfgs_jax.geometry import se3
from sfgs_jax.slam.keyframes import (
    advance_graph,
    edge_of,
    positions,
    settled,
    with_adjustment_begun,
    with_adjustment_taken,
    with_frame_passed,
    with_positions,
)
from sfgs_jax.slam.state import Adjustment, Landmarks, PendingAdjustment


@pytest.fixture(scope="module")
def run(room, frames, config):
    return run_of_five_keyframes(room, frames, config)


def information(rng):
    root = rng.normal(size=(6, 6))
    scale = np.repeat([300.0, 500.0], 3)
    return scale[:, None] * (root @ root.T + 0.1 * np.eye(6)) * scale


def test_an_edge_knows_where_the_surface_alone_is_at_rest(config, rng):
    """Two quadratic costs with optima some millimetres apart, and their joint optimum: each can be told."""
    by_surface, by_keypoints = information(rng), information(rng)
    apart = rng.normal(scale=2e-3, size=6)
    # In the tangent at the surface's optimum, where the keypoints' is `apart`.
    joint = np.linalg.solve(by_surface + by_keypoints, by_keypoints @ apart)
    surface_optimum = se3.exp(jnp.asarray([0.1, -0.2, 0.05, 0.1, 0.2, -0.1]))
    at = [se3.compose(surface_optimum, se3.exp(jnp.asarray(x, jnp.float32))) for x in (joint, apart)]
    found = registration(at[0])
    found = replace(
        found,
        surface_information=jnp.asarray(by_surface, jnp.float32),
        matched=replace(
            found.matched, T_target_source=at[1], information=jnp.asarray(by_keypoints, jnp.float32)
        ),
    )
    edge = edge_of(0, 1, found, config.graph, np.zeros(0))
    off = se3.log(se3.compose(se3.inverse(surface_optimum), jaxlie.SE3(jnp.asarray(edge.surface_motion))))
    assert np.linalg.norm(joint) > 5e-4
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(joint)


def test_a_direction_that_the_surface_leaves_free_stays_as_it_was_found(config):
    """A wall fixes no motion along it: there the surface has no optimum of its own."""
    wall = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-3])
    shifted = se3.exp(jnp.asarray([0.02, 0.0, 0.001, 0.0, 0.0, 0.0]))
    found = registration(se3.identity())
    found = replace(
        found,
        surface_information=jnp.asarray(wall, jnp.float32),
        matched=replace(found.matched, T_target_source=shifted, information=1e6 * jnp.eye(6)),
    )
    motion = edge_of(0, 1, found, config.graph, np.zeros(0)).surface_motion
    np.testing.assert_allclose(motion[4:], [0, 0, -0.001], atol=2e-5)


def test_landmarks_move_with_their_keyframes(run):
    graph, numbers = run.graph, np.arange(10)
    before = positions(graph, numbers)
    shift = np.zeros_like(graph.poses)
    shift[:, 4:] = [1.0, 2.0, 3.0]
    after = positions(replace(graph, poses=graph.poses + shift), numbers)
    np.testing.assert_allclose(after, before + shift[:1, 4:], atol=1e-5)
    np.testing.assert_allclose(positions(with_positions(graph, numbers, before + 0.1), numbers), before + 0.1)


def test_each_match_counts_once(run, config):
    """Edges between keyframes weigh by the surface alone, and keypoints by the landmarks that they show."""
    window = slam.window_of(run.params, run.graph, config.graph)
    seen, surfaces, loops, _ = window.graph.factors
    assert isinstance(surfaces, RelativePose)
    shown = sum(int((k.landmarks >= 0).sum()) for k in run.graph.keyframes[-config.graph.window :])
    assert 20 < int(seen.valid.sum()) <= shown
    inside = [e for e in run.graph.edges if min(e.target, e.source) >= 1]
    assert int(surfaces.valid.sum()) == len(inside)
    np.testing.assert_array_equal(
        np.asarray(surfaces.measured.wxyz_xyz)[: len(inside)], [e.surface_motion for e in inside]
    )
    assert not loops.valid.any()


def test_a_landmark_that_many_keyframes_show_needs_no_larger_program(run, config):
    """A camera that stays sees one landmark in more keyframes than a cluster has room for."""
    graph, config = run.graph, replace(config.graph, window=60)
    times = 10
    crowd = replace(
        graph,
        keyframes=graph.keyframes * times,
        poses=np.tile(graph.poses, (times, 1)),
        covariances=np.tile(graph.covariances, (times, 1, 1)),
        depth_sensitivities=np.tile(graph.depth_sensitivities, (times, 1, 1)),
        signatures=np.tile(graph.signatures, (times, 1)),
        edges=tuple(replace(graph.edges[0], target=i, source=i + 1) for i in range(5 * times - 1)),
    )
    few, many = (slam.window_of(run.params, g, config).graph for g in (graph, crowd))
    assert many.structure.cluster_poses.shape == few.structure.cluster_poses.shape
    seen = many.factors[0]
    room = few.structure.cluster_poses.shape[1]
    landmarks, poses = (np.asarray(x)[np.asarray(seen.valid)] for x in (seen.landmarks, seen.poses[:, 0]))
    assert np.bincount(landmarks).max() == room
    # The observations that are left lie all over the time in which it was seen.
    often = poses[landmarks == np.bincount(landmarks).argmax()]
    assert np.ptp(often) > 40


def test_keyframes_tied_to_others_outside_hold_the_window_in_place(run, config):
    """Five keyframes and room for four: the first is left out, and what is tied to it stays."""
    window = slam.window_of(run.params, run.graph, config.graph)
    members = np.asarray(window.members).tolist()
    assert members == [1, 2, 3, 4]
    outside = {max(e.target, e.source) for e in run.graph.edges if 0 in (e.target, e.source)}
    free = np.asarray(window.graph.free_poses)
    assert [m for m, moves in zip(members, free, strict=True) if not moves] == sorted(outside)
    assert free.any()
    # The first keyframe holds the window if all have room.
    window = slam.window_of(run.params, run.graph, replace(config.graph, window=8))
    assert np.asarray(window.graph.free_poses).tolist() == [False] + [True] * 4 + [False] * 3


def test_results_are_taken_so_many_frames_later(run, config):
    begun = with_adjustment_begun(run.params, run.graph, replace(config.graph, adjustment_frames=2))
    graph = begun
    for _ in range(2):
        graph = with_frame_passed(graph)
        np.testing.assert_array_equal(graph.poses, run.graph.poses)
    graph = with_frame_passed(graph)
    assert graph.adjustment is None
    np.testing.assert_array_equal(graph.poses, with_adjustment_taken(begun).poses)
    assert np.abs(graph.poses - run.graph.poses).max() > 1e-5


def test_the_next_adjustment_begins_after_the_one_under_way(run, config):
    pairs = [(edge.target, edge.source) for edge in run.graph.edges]
    settings = replace(config.graph, adjustment_frames=2)
    graph = with_adjustment_begun(run.params, replace(run.graph, num_absorbed=len(pairs)), settings)
    graph = replace(graph, pending=(pairs[1],), again=())
    begun = []
    for _ in range(5):
        graph, _ = advance_graph(run.params, graph, settings, grown=False)
        begun.append((graph.adjustment is not None, graph.num_absorbed < len(graph.edges)))
    # The new edge is left out for two frames. Then it is taken in, and nothing is left to do.
    assert begun == [(True, True), (True, True), (True, False), (True, False), (True, False)]
    graph, _ = advance_graph(run.params, graph, settings, grown=False)
    assert graph.adjustment is None


@pytest.mark.parametrize(("new", "begins"), [(9, False), (10, True)])
def test_many_new_edges_wait_for_no_other_pair(run, config, new, begins):
    """A camera that takes a keyframe every few frames always has pairs that wait."""
    first = run.graph.edges[0]
    graph = replace(
        run.graph,
        edges=(first,) * (new + 2),
        num_absorbed=2,
        pending=((first.target, first.source),),
        tracked=(),
        adjustment=None,
    )
    graph, _ = advance_graph(run.params, graph, config.graph, grown=False, registered=())
    assert graph.pending
    assert (graph.adjustment is not None) is begins
    assert graph.num_absorbed == (new + 2 if begins else 2)


def test_a_bent_graph_has_more_time_the_larger_it_is(run, config):
    assert len(run.graph.keyframes) == 5
    settings = replace(config.graph, adjustment_frames=3, window=2)
    frames = [
        with_adjustment_begun(run.params, run.graph, settings, bent=bent).adjustment.frames_left
        for bent in (False, True)
    ]
    assert frames == [3, 6]


def test_keyframes_that_came_meanwhile_move_with_their_reference(run):
    """The adjustment of the first three turns the third by a tenth; the fourth and fifth go with it."""
    turn = se3.exp(jnp.asarray([0.0, 0.0, 0.02, 0.0, 0.1, 0.0]))
    moved = np.asarray(se3.compose(run.graph.pose(2), turn).wxyz_xyz)
    poses = np.concatenate([run.graph.poses[:2], moved[None]])
    none = np.zeros(0, int)
    found = Adjustment(
        poses=poses,
        members=np.arange(3),
        anchor=0,
        covariances=np.zeros((3, 6, 6)),
        landmarks=none,
        points=np.zeros((0, 3), np.float32),
    )
    pending = PendingAdjustment(found, 0)
    graph = replace(run.graph, landmarks=Landmarks(none, np.zeros((0, 3))), adjustment=pending)
    after = with_adjustment_taken(graph)
    assert [k.reference for k in graph.keyframes] == [0, 0, 1, 2, 3]
    before, now = (se3.matrices_of(poses) for poses in (graph.poses, after.poses))
    np.testing.assert_allclose(now[:2], before[:2], atol=1e-6)
    for number in (3, 4):
        np.testing.assert_allclose(
            np.linalg.inv(now[2]) @ now[number], np.linalg.inv(before[2]) @ before[number], atol=1e-5
        )
    # The first keyframe of another map stays, and what was tracked in it.
    keyframes = list(graph.keyframes)
    keyframes[3] = replace(keyframes[3], reference=3)
    after = with_adjustment_taken(replace(graph, keyframes=tuple(keyframes)))
    np.testing.assert_allclose(after.poses[3:], graph.poses[3:], atol=1e-6)


def test_a_run_saved_during_an_adjustment_goes_on_to_the_bit(room, frames, config, tmp_path):
    settings = replace(config, graph=replace(config.graph, adjustment_frames=3))
    state = slam.init(room.camera, settings)
    resumed = None
    for frame in frames:
        if resumed is None and state.graph.adjustment is not None:
            slam.save(state, tmp_path)
            resumed = slam.load(tmp_path, settings)
        state, _ = slam.step(state, frame)
        if resumed is not None:
            resumed, _ = slam.step(resumed, frame)
    assert resumed is not None
    np.testing.assert_array_equal(state.graph.poses, resumed.graph.poses)
    np.testing.assert_array_equal(state.trajectory.poses, resumed.trajectory.poses)


def test_a_pair_that_is_registered_again_replaces_its_edge(run, config):
    pairs = [(edge.target, edge.source) for edge in run.graph.edges]
    graph = replace(run.graph, pending=(pairs[1],), adjustment=None, num_absorbed=len(pairs))
    after, _ = advance_graph(run.params, graph, config.graph, grown=False)
    again = [(edge.target, edge.source) for edge in after.edges]
    assert again == [pairs[0], *pairs[2:], pairs[1]]


def test_finish_leaves_nothing_waiting_and_more_frames_may_follow(run, room, frames):
    assert run.graph.adjustment is not None
    state = slam.finish(run)
    assert not state.graph.pending
    assert state.graph.adjustment is None
    np.testing.assert_array_equal(state.mapping.keyframe_poses, state.graph.poses)
    np.testing.assert_allclose(slam.finish(state).graph.poses, state.graph.poses, atol=3e-4)
    truth = room.ground_truth.poses[[0, 3, 5, 8, 10]]
    wanted = np.linalg.inv(truth[0]) @ truth
    np.testing.assert_allclose(state.trajectory.poses[:, :3, 3], wanted[:, :3, 3], atol=0.01)
    _, info = slam.step(state, frames[11])
    assert info.tracked


def test_settled_windows_would_not_move_their_keyframes_again(run, config):
    """Five keyframes in windows of four, the last of them off by a centimetre."""
    few = replace(config.graph, window=4)
    moved = run.graph.poses.copy()
    moved[-1, 4:] += 0.01
    graph = replace(run.graph, adjustment=None, pending=(), poses=moved)
    after = settled(run.params, graph, few)
    assert np.abs(after.poses - moved).max() > 5e-3
    for centre in range(1, len(moved)):
        again = with_adjustment_taken(with_adjustment_begun(run.params, after, few, around=centre))
        np.testing.assert_allclose(again.poses, after.poses, atol=3e-4)


def factor(inputs, kind):
    return next(f for f in inputs[1].graph.factors if isinstance(f, kind))


@pytest.mark.usefixtures("float64")
def test_an_adjustment_has_the_slopes_of_finite_differences(run, config, rng):
    """Poses and covariances by the camera, the keypoints and the registrations' information."""
    inputs = run.params, slam.window_of(run.params, run.graph, config.graph)
    inputs = jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float64) if eqx.is_inexact_array_like(x) else x, inputs
    )

    @eqx.filter_jit
    def outcome(inputs):
        adjusted = slam.adjust(*inputs)
        values, spread = adjusted.solution.values, jnp.trace(adjusted.covariances, axis1=1, axis2=2)
        return jnp.sum(values.poses.wxyz_xyz[:, 4:] @ jnp.arange(1.0, 4)) + 1e3 * jnp.sum(spread), values

    def at_its_optimum(inputs):
        for _ in range(25):
            inputs = eqx.tree_at(lambda i: i[1].values, inputs, outcome(inputs)[1])
        return inputs

    @eqx.filter_jit
    def slope(inputs, rates):
        return eqx.filter_jvp(lambda inputs: outcome(inputs)[0], (inputs,), (rates,))[1]

    inputs = at_its_optimum(inputs)
    still = jax.tree.map(lambda x: jnp.zeros_like(x) if eqx.is_inexact_array(x) else None, inputs)
    matrices = factor(inputs, RelativePose).matrices
    share = 1e-3 * rng.normal(size=(len(matrices), 1, 1))
    for part, change in [
        (lambda i: i[0].camera.fx, jnp.asarray(1e-2, jnp.float64)),
        (lambda i: factor(i, RgbdReprojection).pixels, 1e-2),
        (lambda i: factor(i, RgbdReprojection).depth, 1e-4),
        (lambda i: factor(i, RelativePose).matrices, share * matrices),
    ]:
        value = part(inputs)
        change = change if np.ndim(change) == value.ndim else change * rng.normal(size=value.shape)
        # Missing depth stays missing.
        change = jnp.where(value == 0, 0, change)
        found = float(slope(inputs, eqx.tree_at(part, still, change)))
        ends = [outcome(at_its_optimum(eqx.tree_at(part, inputs, value + d)))[0] for d in (change, -change)]
        assert found == pytest.approx(float(ends[0] - ends[1]) / 2, rel=1e-4)
        assert abs(found) > 1e-7
