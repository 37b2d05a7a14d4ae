"""What is not known about depth moves all keyframes, and more so the longer the way."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.frontend import feature_shapes
from sfgs_jax.slam.keyframes import merged, prior_noise, with_drift_since
from sfgs_jax.slam.state import Edge, FrameLog, Keyframe, empty_graph, empty_log, newest_covariance

REFERENCES = (0, 0, 1, 1, 3, 5, 5)
"""The fourth keyframe was tracked in the second, and the last two are another map."""
CHANGE = np.asarray([2e-4, -3e-4, 1e-4])
"""Of the three errors of depth."""


@pytest.fixture(scope="module")
def features(room, config):
    return feature_shapes(slam.init(room.camera, config).params)


@pytest.fixture
def motions(rng):
    """Each keyframe's motion in its reference."""
    return np.asarray(se3.exp(jnp.asarray(0.3 * rng.normal(size=(7, 6)), jnp.float32)).wxyz_xyz)


def edge(target, source, motion, sensitivity):
    information = 1e6 * np.eye(6, dtype=np.float32)
    told = (motion, information)
    return Edge(target, source, *told, *told, False, False, np.zeros(3), sensitivity, sensitivity)


@pytest.fixture
def graph(features, motions, rng):
    """Keyframes that nothing is known about yet, and edges that depth moves."""
    identity, still = np.asarray([1, 0, 0, 0, 0, 0, 0], np.float32), np.zeros(6, np.float32)
    keyframes, poses, edges = [], [], []
    for number, (reference, motion) in enumerate(zip(REFERENCES, motions, strict=True)):
        first = reference == number
        tracked = identity if first else motion
        keyframes.append(
            Keyframe(features, np.full(4, -1), number, reference, tracked, np.zeros(3), still, still[:3], 0)
        )
        pose = np.eye(4) if first else poses[reference]
        poses.append(pose @ se3.matrices_of(tracked[None])[0])
        if not first:
            edges.append(edge(reference, number, motion, rng.normal(size=(6, 3))))
    return replace(
        empty_graph(np.zeros(3), prior_noise(slam.GraphConfig()), 1),
        keyframes=tuple(keyframes),
        poses=se3.parameters_of(np.stack(poses)),
        covariances=1e-6 * np.arange(7)[:, None, None] * np.eye(6),
        signatures=np.zeros((7, 1), np.float32),
        edges=tuple(edges),
        depth_covariance=np.diag([1e-6, 4e-6, 9e-6]),
        depth_sensitivities=np.zeros((7, 6, 3)),
    )


def poses_along(graph, change):
    """Poses by the motions that edges have once depth has changed, as matrices."""
    shifts = {(e.target, e.source): e.sensitivity @ change for e in graph.edges}
    poses = []
    for number, keyframe in enumerate(graph.keyframes):
        if keyframe.reference == number:
            poses.append(se3.matrices_of(graph.poses[number][None])[0])
            continue
        motion = se3.matrices_of(keyframe.T_reference_keyframe[None])[0]
        shift = se3.to_matrices(se3.exp(jnp.asarray(shifts[keyframe.reference, number][None])))[0]
        poses.append(poses[keyframe.reference] @ motion @ np.asarray(shift))
    return np.stack(poses)


def test_the_drift_adds_up_along_the_way(graph):
    found = with_drift_since(graph, 0)
    moved = se3.logs_of(np.linalg.inv(poses_along(graph, 0 * CHANGE)) @ poses_along(graph, CHANGE))
    np.testing.assert_allclose(found.depth_sensitivities @ CHANGE, moved, atol=2e-6)
    assert np.linalg.norm(moved[4]) > 5e-4
    assert not found.depth_sensitivities[[0, 5]].any()


def test_an_edge_that_becomes_known_moves_the_later_keyframes_too(graph):
    """Those that came before the edge was known had been carried with their references."""
    unknown = replace(graph.edges[0], sensitivity=np.zeros((6, 3)))
    before = with_drift_since(replace(graph, edges=(unknown, *graph.edges[1:])), 0)
    after = with_drift_since(replace(before, edges=graph.edges), 1)
    np.testing.assert_allclose(
        after.depth_sensitivities, with_drift_since(graph, 0).depth_sensitivities, atol=1e-12
    )
    assert not np.allclose(before.depth_sensitivities[4], after.depth_sensitivities[4], atol=0.1)


def test_the_covariance_of_a_pose_has_the_drift(graph):
    """A frame as far from the first camera as its keyframe has the keyframe's, and its own."""
    graph = with_drift_since(graph, 0)
    still = se3.identity()
    log: FrameLog = empty_log().with_frame(0.0, 9, 4, still, 1e-6 * np.eye(6))
    moved = graph.depth_sensitivities[4]
    expected = 5e-6 * np.eye(6) + moved @ graph.depth_covariance @ moved.T
    np.testing.assert_allclose(newest_covariance(log, graph), expected, rtol=1e-6, atol=1e-12)
    assert np.trace(expected) > 5 * np.trace(5e-6 * np.eye(6))


@pytest.mark.parametrize("turned", [False, True])
def test_a_map_that_is_merged_moves_with_the_one_it_joins(graph, motions, rng, turned):
    """By the edge that ties them, whichever way round that was registered."""
    graph = with_drift_since(graph, 0)
    by_depth = rng.normal(size=(6, 3))
    tie = edge(4, 6, motions[0], by_depth)
    if turned:
        back = se3.matrices_of(motions[:1])
        tie = edge(
            6,
            4,
            se3.parameters_of(np.linalg.inv(back))[0].astype(np.float32),
            -se3.adjoints_of(back)[0] @ by_depth,
        )
    found = merged(graph, np.asarray([0, 0, 0, 0, 0, 5, 5]), [tie])

    def placed(change):
        poses = poses_along(graph, change)
        shift = np.asarray(se3.to_matrices(se3.exp(jnp.asarray((by_depth @ change)[None]))))[0]
        at = poses[4] @ se3.matrices_of(motions[:1])[0] @ shift
        return np.concatenate([poses[:5], at @ np.linalg.inv(poses[6]) @ poses[5:]])

    moved = se3.logs_of(np.linalg.inv(placed(0 * CHANGE)) @ placed(CHANGE))
    np.testing.assert_allclose(found.depth_sensitivities @ CHANGE, moved, atol=3e-6)
