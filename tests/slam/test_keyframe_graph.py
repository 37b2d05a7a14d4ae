"""The graph of keyframes: what it makes of registrations, and which loops it believes."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.graph import neighbours, optimise_poses
from sfgs_jax.slam.loops import believe, is_candidate, with_candidate
from sfgs_jax.slam.matched_motion import MatchedMotion
from sfgs_jax.slam.nodes import Edge, Keyframe
from sfgs_jax.slam.observation import blank_observation
from sfgs_jax.slam.registration import Carrier, Registration

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
    observation = blank_observation(room.camera, config.tracking)
    T, keyframes, edges = se3.identity(), [], []
    for i in range(COUNT):
        keyframes.append(Keyframe(observation, T, np.full(4, -1), 10 * i))
        if i + 1 < COUNT:
            step = se3.compose(se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 1]), drift)
            edges.append(edge(i, i + 1, step))
            T = se3.compose(T, step)
    return replace(state, keyframes=tuple(keyframes), edges=tuple(edges))


def edge(a, b, T, *, loop=False):
    information = jnp.eye(6) * 1e4
    return Edge(a, b, T, information, information, loop)


def true_loop(circle, a, b):
    return edge(a, b, se3.from_matrix(np.linalg.inv(circle[a]) @ circle[b]))


def found(edge, *, inliers=100, fraction=0.7):
    matched = MatchedMotion(
        edge.T_target_source,
        jnp.eye(6),
        jnp.zeros(4, int),
        jnp.zeros(4, bool),
        jnp.asarray(2 * inliers),
        jnp.asarray(inliers),
    )
    zero = jnp.zeros(())
    return Registration(
        edge.T_target_source,
        jnp.eye(6),
        matched,
        jnp.asarray(int(Carrier.BOTH)),
        jnp.asarray(fraction),
        zero,
        jnp.asarray(0),
    )


def end_error(state, circle):
    return np.linalg.norm(np.asarray(state.keyframes[-1].T_world_cam.wxyz_xyz[4:]) - circle[-1, :3, 3])


def test_a_closed_loop_brings_the_end_back(drifted, circle):
    before = end_error(drifted, circle)
    assert before > 0.1
    candidates = true_loop(circle, 0, COUNT - 1), true_loop(circle, 1, COUNT - 1)
    assert all(is_candidate(drifted, e.target, e.source, found(e)) for e in candidates)
    state, closed = believe(with_candidate(drifted, candidates[0]))
    assert not closed, "one loop alone is not believed"
    state, closed = believe(with_candidate(state, candidates[1]))
    assert closed
    assert len(state.loops) == 2
    state = optimise_poses(state)
    assert end_error(state, circle) < before / 5
    np.testing.assert_allclose(state.keyframes[0].T_world_cam.wxyz_xyz, [1, 0, 0, 0, 0, 0, 0], atol=1e-6)


def test_loops_that_contradict_each_other_close_nothing(drifted, circle):
    wrong = se3.exp(jnp.asarray([0.3, 0.0, 0.2, 0.0, 0.2, 0.0]))
    a = true_loop(circle, 0, COUNT - 1)
    b = replace(a, target=1, T_target_source=se3.compose(a.T_target_source, wrong))
    state = with_candidate(with_candidate(drifted, a), b)
    _, closed = believe(state)
    assert not closed


def test_a_place_that_only_looks_the_same_is_no_loop(drifted):
    """Half way round the camera believes to be back where it began, two rooms alike: four metres off."""
    half = COUNT // 2
    twin = edge(0, half, se3.identity())
    assert not is_candidate(drifted, 0, half, found(twin))


@pytest.mark.parametrize("weak", [{"inliers": 10}, {"fraction": 0.2}])
def test_a_loop_must_be_borne_out_by_keypoints_and_surface(drifted, circle, weak):
    loop = true_loop(circle, 0, COUNT - 1)
    assert not is_candidate(drifted, 0, COUNT - 1, found(loop, **weak))


def test_one_wrong_registration_does_not_bend_the_rest(drifted, circle):
    """Among true edges to the neighbour after next, one that is half a metre off."""
    exact = [
        edge(i, i + 1, se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 1])) for i in range(COUNT - 1)
    ]
    skips = [
        edge(i, i + 2, se3.from_matrix(np.linalg.inv(circle[i]) @ circle[i + 2])) for i in range(COUNT - 2)
    ]
    off = se3.exp(jnp.asarray([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    skips[5] = replace(skips[5], T_target_source=se3.compose(skips[5].T_target_source, off))
    state = optimise_poses(replace(drifted, edges=(*exact, *skips)))
    positions = state.keyframe_poses[:, 4:]
    assert np.max(np.linalg.norm(positions - circle[:, :3, 3], axis=1)) < 0.06


def test_neighbours_look_at_the_same(drifted, circle):
    placed = tuple(
        replace(k, T_world_cam=se3.from_matrix(T)) for k, T in zip(drifted.keyframes, circle, strict=True)
    )
    config = drifted.config
    state = replace(
        drifted,
        keyframes=placed,
        edges=drifted.edges[-1:],
        config=replace(config, graph=replace(config.graph, num_neighbours=8)),
    )
    # Around the circle by 24 degrees each; the last stands where the first does, and knows its predecessor.
    assert set(neighbours(state)) == {(0, COUNT - 1), (1, COUNT - 1)}


def test_frames_follow_their_keyframe(drifted):
    log = drifted.log.with_frame(1.0, 3, 2, se3.exp(jnp.asarray([0.1, 0, 0, 0, 0, 0.0])))
    state = replace(drifted, log=log)
    moved = se3.exp(jnp.asarray([0.0, 0.5, 0.0, 0.2, 0.0, 0.0]))
    keyframes = list(state.keyframes)
    keyframes[2] = replace(keyframes[2], T_world_cam=se3.compose(moved, keyframes[2].T_world_cam))
    after = replace(state, keyframes=tuple(keyframes)).trajectory.poses[0]
    expected = np.asarray(se3.matrix(moved)) @ state.trajectory.poses[0]
    np.testing.assert_allclose(after, expected, atol=1e-5)


def test_frames_between_two_keyframes_share_out_what_the_graph_found(drifted):
    """The second keyframe moves by 4 cm and turns: the frames on the way to it move by their share."""
    log, keyframes = drifted.log, list(drifted.keyframes)
    step = drifted.edges[0].T_target_source
    half = se3.exp(se3.log(step) / 2)
    for number, keyframe, motion in ((0, 0, se3.identity()), (5, 0, half), (10, 1, se3.identity())):
        log = log.with_frame(number / 30, number, keyframe, motion)
    before = replace(drifted, log=log).trajectory.poses
    shift = se3.exp(jnp.asarray([0.04, 0.0, 0.0, 0.0, 0.02, 0.0]))
    keyframes[1] = replace(keyframes[1], T_world_cam=se3.compose(keyframes[1].T_world_cam, shift))
    after = replace(drifted, log=log, keyframes=tuple(keyframes)).trajectory.poses
    moved = np.linalg.norm(after[:, :3, 3] - before[:, :3, 3], axis=1)
    np.testing.assert_allclose(moved, [0.0, 0.02, 0.04], atol=1e-4)
    turned = np.linalg.inv(before[1]) @ after[1]
    np.testing.assert_allclose(np.arccos((np.trace(turned[:3, :3]) - 1) / 2), 0.01, atol=1e-4)
