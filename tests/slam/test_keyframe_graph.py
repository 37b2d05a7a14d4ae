"""The graph of keyframes: what it makes of registrations, and which loops it believes."""

from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from registrations import registration

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.frontend import feature_shapes, supports_loop
from sfgs_jax.slam.keyframes import (
    accept_consistent_loops,
    bend,
    compile_ahead,
    is_contradicted,
    likely_drift,
    neighbours,
    optimise_poses,
    with_candidate,
)
from sfgs_jax.slam.state import Edge, Keyframe

COUNT = 16


@pytest.fixture
def circle():
    """Poses of a camera that goes once round a circle of two metres, looking outwards."""
    angle = np.linspace(0, 2 * np.pi, COUNT)
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3] = [[[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]] for a in angle]
    poses[:, :3, 3] = 2 * poses[:, :3, 2]
    return np.linalg.inv(poses[0]) @ poses


@pytest.fixture
def drifted(room, config, circle):
    """A state whose keyframes went round that circle with an error in each step."""
    state = slam.init(room.camera, replace(config, graph=replace(config.graph, loop_gap=6)))
    drift = se3.exp(jnp.asarray([0.008, 0.004, 0.0, 0.0, 0.006, 0.0]))
    features, still = feature_shapes(state.params), np.zeros(6, np.float32)
    T, poses, keyframes, edges = se3.identity(), [], [], []
    tracked = se3.identity()
    for i in range(COUNT):
        poses.append(np.asarray(T.wxyz_xyz))
        keyframes.append(
            Keyframe(
                features,
                np.full(4, -1),
                10 * i,
                max(i - 1, 0),
                np.asarray(tracked.wxyz_xyz),
                np.zeros(0),
                still,
                still[:3],
                0,
            )
        )
        if i + 1 < COUNT:
            tracked = se3.compose(se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 1]), drift)
            edges.append(edge(i, i + 1, tracked))
            T = se3.compose(T, tracked)
    graph = replace(
        state.graph,
        keyframes=tuple(keyframes),
        poses=np.stack(poses),
        covariances=np.arange(COUNT)[:, None, None] * 0.02**2 * np.eye(6),
        depth_sensitivities=np.zeros((COUNT, 6, 0)),
        signatures=np.zeros((COUNT, state.graph.signatures.shape[1]), np.float32),
        edges=tuple(edges),
    )
    return replace(state, graph=graph)


def edge(a, b, T):
    information = np.eye(6, dtype=np.float32) * 1e4
    motion, none, free = np.asarray(T.wxyz_xyz), np.zeros(0), np.zeros((6, 0))
    return Edge(a, b, motion, information, motion, information, b - a > 6, False, none, free, free)


def true_loop(circle, a, b):
    return edge(a, b, se3.from_matrix(np.linalg.inv(circle[a]) @ circle[b]))


def may_close(state, edge, **evidence):
    """True if a registration may close a loop of the state's graph."""
    graph, found = state.graph, registration(jaxlie.SE3(jnp.asarray(edge.T_target_source)), **evidence)
    guess = se3.compose(se3.inverse(graph.pose(edge.target)), graph.pose(edge.source))
    off = np.asarray(se3.log(se3.compose(se3.inverse(guess), found.T_target_source)))
    drift = likely_drift(graph, edge.target, edge.source, state.config.graph)
    return supports_loop(found, off, drift, state.config.graph)


def end_error(state, circle):
    return np.linalg.norm(state.graph.poses[-1, 4:] - circle[-1, :3, 3])


def test_a_closed_loop_brings_the_end_back(drifted, circle):
    before = end_error(drifted, circle)
    assert before > 0.1
    candidates = true_loop(circle, 0, COUNT - 1), true_loop(circle, 1, COUNT - 1)
    assert all(may_close(drifted, e) for e in candidates)
    config = drifted.config.graph
    graph, closed = accept_consistent_loops(with_candidate(drifted.graph, candidates[0], config), config)
    assert not closed, "one loop alone is not accepted"
    graph, closed = accept_consistent_loops(with_candidate(graph, candidates[1], config), config)
    assert closed
    assert len(graph.loops) == 2
    graph = optimise_poses(graph, config)
    assert end_error(replace(drifted, graph=graph), circle) < before / 5
    np.testing.assert_allclose(graph.poses[0], [1, 0, 0, 0, 0, 0, 0], atol=1e-6)


def test_a_loop_bends_the_graph_as_it_stands(drifted, circle):
    """The poses have been corrected since the edges were measured: a loop that agrees leaves them alone."""
    config = drifted.config.graph
    poses = np.stack([np.asarray(se3.from_matrix(T).wxyz_xyz) for T in circle])
    loop = replace(true_loop(circle, 0, COUNT - 1), loop=True)
    old = drifted.graph.edges
    graph = replace(drifted.graph, poses=poses, edges=(*old, loop), num_absorbed=len(old))
    np.testing.assert_allclose(bend(graph, config).poses[:, 4:], poses[:, 4:], atol=1e-4)
    # From the poses that have drifted it brings the end back.
    graph = replace(graph, poses=drifted.graph.poses)
    before = end_error(drifted, circle)
    assert end_error(replace(drifted, graph=bend(graph, config)), circle) < before / 5


def test_only_a_place_seen_elsewhere_contradicts_the_graph(drifted, circle):
    poses = np.stack([np.asarray(se3.from_matrix(T).wxyz_xyz) for T in circle])
    old, again = drifted.graph.edges, true_loop(circle, 0, COUNT - 1)
    graph = replace(drifted.graph, edges=(*old, again), num_absorbed=len(old))
    assert is_contradicted(graph)
    assert not is_contradicted(replace(graph, poses=poses))
    assert not is_contradicted(replace(graph, num_absorbed=len(old) + 1))


def test_a_large_graph_bends_as_a_small_one(drifted, circle):
    """Beyond 128 keyframes the solver is sparse."""
    config = drifted.config.graph
    loop = replace(true_loop(circle, 0, COUNT - 1), loop=True)
    graph = replace(drifted.graph, edges=(*drifted.graph.edges, loop), num_absorbed=COUNT - 1)
    small, large = (bend(graph, replace(config, capacity=capacity)) for capacity in (16, 256))
    assert np.abs(small.poses - graph.poses).max() > 0.05
    np.testing.assert_allclose(large.poses, small.poses, atol=1e-4)


def test_the_solver_is_compiled_before_the_graph_needs_it(drifted, circle, compilations):
    """Three quarters full, the solver for twice as many keyframes is compiled in the background."""
    config = replace(drifted.config.graph, capacity=COUNT)
    prepared = compile_ahead(drifted.graph, config)
    assert prepared is not None
    prepared.result()
    loop = replace(true_loop(circle, 0, COUNT - 1), loop=True)
    before = len(compilations)
    bend(replace(drifted.graph, edges=(*drifted.graph.edges, loop)), replace(config, capacity=2 * COUNT))
    assert len(compilations) == before
    assert compile_ahead(drifted.graph, replace(config, capacity=2 * COUNT)) is None


def test_loops_that_contradict_each_other_close_nothing(drifted, circle):
    wrong = se3.exp(jnp.asarray([0.3, 0.0, 0.2, 0.0, 0.2, 0.0]))
    a, config = true_loop(circle, 0, COUNT - 1), drifted.config.graph
    off = se3.compose(jaxlie.SE3(jnp.asarray(a.T_target_source)), wrong)
    b = replace(a, target=1, T_target_source=np.asarray(off.wxyz_xyz))
    graph = with_candidate(with_candidate(drifted.graph, a, config), b, config)
    _, closed = accept_consistent_loops(graph, config)
    assert not closed


def test_old_candidates_make_room(drifted, circle):
    config = replace(drifted.config.graph, max_loop_candidates=2)
    graph = drifted.graph
    for target in (0, 1, 2):
        graph = with_candidate(graph, true_loop(circle, target, COUNT - 1), config)
    assert [candidate.target for candidate in graph.candidates] == [1, 2]


def test_a_place_that_only_looks_the_same_is_no_loop(drifted):
    """Half way round the camera believes to be back where it began, two rooms alike: four metres off."""
    assert not may_close(drifted, edge(0, COUNT // 2, se3.identity()))


def test_a_loop_mends_no_more_than_the_graph_is_uncertain_of(drifted):
    """Two rooms that look alike, after a way so long that its share would allow any correction."""
    graph, config = drifted.graph, replace(drifted.config.graph, max_drift=100.0)
    sigma = np.sqrt(3 * (COUNT - 1)) * 0.02
    assert likely_drift(graph, 0, COUNT - 1, config) == pytest.approx(5 * sigma)
    short = replace(config, max_drift=0.001)
    assert likely_drift(graph, 0, COUNT - 1, short) < 0.02


@pytest.mark.parametrize("weak", [{"inliers": 10}, {"fraction": 0.2}])
def test_a_loop_must_be_borne_out_by_keypoints_and_surface(drifted, circle, weak):
    assert not may_close(drifted, true_loop(circle, 0, COUNT - 1), **weak)


def test_one_wrong_registration_does_not_bend_the_rest(drifted, circle):
    """Among true edges to the neighbour after next, one that is half a metre off."""
    exact = [
        edge(i, i + 1, se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 1])) for i in range(COUNT - 1)
    ]
    skips = [
        edge(i, i + 2, se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 2])) for i in range(COUNT - 2)
    ]
    off = se3.exp(jnp.asarray([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    moved = se3.compose(jaxlie.SE3(jnp.asarray(skips[5].T_target_source)), off)
    skips[5] = replace(skips[5], T_target_source=np.asarray(moved.wxyz_xyz))
    graph = replace(drifted.graph, edges=(*exact, *skips))
    positions = optimise_poses(graph, drifted.config.graph).poses[:, 4:]
    assert np.max(np.linalg.norm(positions - circle[:, :3, 3], axis=1)) < 0.06


def test_neighbours_look_at_the_same(drifted, circle):
    poses = np.stack([np.asarray(se3.from_matrix(T).wxyz_xyz) for T in circle])
    graph = replace(drifted.graph, poses=poses, edges=drifted.graph.edges[-1:])
    config = replace(drifted.config.graph, num_neighbours=8)
    # Around the circle by 24 degrees each; the last stands where the first does, and knows its predecessor.
    assert set(neighbours(graph, config)) == {(0, COUNT - 1), (1, COUNT - 1)}


def with_pose(graph, number, T_world_cam):
    poses = graph.poses.copy()
    poses[number] = T_world_cam.wxyz_xyz
    return replace(graph, poses=poses)


def test_frames_follow_their_keyframe(drifted):
    log = drifted.log.with_frame(1.0, 3, 2, se3.exp(jnp.asarray([0.1, 0, 0, 0, 0, 0.0])), np.zeros((6, 6)))
    state = replace(drifted, log=log)
    moved = se3.exp(jnp.asarray([0.0, 0.5, 0.0, 0.2, 0.0, 0.0]))
    after = replace(state, graph=with_pose(state.graph, 2, se3.compose(moved, state.graph.pose(2))))
    after = after.trajectory.poses[0]
    expected = np.asarray(se3.matrix(moved)) @ state.trajectory.poses[0]
    np.testing.assert_allclose(after, expected, atol=1e-5)


def test_frames_between_two_keyframes_share_out_what_the_graph_found(drifted):
    """The second keyframe moves by 4 cm and turns: the frames on the way to it move by their share."""
    log = drifted.log
    step = jaxlie.SE3(jnp.asarray(drifted.graph.edges[0].T_target_source))
    half = se3.exp(se3.log(step) / 2)
    for number, keyframe, motion in ((0, 0, se3.identity()), (5, 0, half), (10, 1, se3.identity())):
        log = log.with_frame(number / 30, number, keyframe, motion, np.zeros((6, 6)))
    before = replace(drifted, log=log).trajectory.poses
    shift = se3.exp(jnp.asarray([0.04, 0.0, 0.0, 0.0, 0.02, 0.0]))
    # The order of the edges has no meaning.
    graph = replace(drifted.graph, edges=drifted.graph.edges[::-1])
    graph = with_pose(graph, 1, se3.compose(graph.pose(1), shift))
    after = replace(drifted, log=log, graph=graph).trajectory.poses
    moved = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
    np.testing.assert_allclose(moved, [0.0, 0.02, 0.04], atol=1e-4)
    turned = np.linalg.inv(before[1]) @ after[1]
    np.testing.assert_allclose(np.arccos((np.trace(turned[:3, :3]) - 1) / 2), 0.01, atol=1e-4)
