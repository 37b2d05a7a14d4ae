"""Noise of the edges by their cycles, and the covariances of poses that follow from it."""

from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest
from registrations import registration

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.slam.frontend import feature_shapes
from sfgs_jax.slam.keyframes import covariances_in_world, edge_noise, motion_covariance, prior_noise
from sfgs_jax.slam.state import Edge, EdgeNoise, Keyframe, prior_of

COUNT, REACH = 40, 4
SCALES = np.repeat([0.004, 0.003], 3)


def edges_with(errors, pairs, poses):
    """Edges of true motions that err by some tangents."""
    none, free, information = np.zeros(0), np.zeros((6, 0)), 1e8 * np.eye(6, dtype=np.float32)
    found = []
    for (a, b), error in zip(pairs, errors, strict=True):
        motion = se3.from_matrix(np.linalg.inv(poses[a]) @ poses[b])
        motion = np.asarray(se3.compose(motion, se3.exp(jnp.asarray(error, jnp.float32))).wxyz_xyz)
        told = (motion, information)
        found.append(Edge(a, b, *told, *told, False, False, none, free, free))
    return tuple(found)


@pytest.fixture(scope="module")
def truth():
    """Covariance that mixes turns and shifts, as a scene ahead of the camera does."""
    rng = np.random.default_rng(3)
    root = np.linalg.qr(rng.normal(size=(6, 6)))[0] * np.asarray([1.5, 1.2, 1.0, 0.8, 0.6, 0.4])
    return SCALES[:, None] * (root @ root.T) * SCALES


def on_an_arc(room, config, covariance, count):
    """The graph of a camera on an arc, each keyframe registered to the four before it, with such errors."""
    rng = np.random.default_rng(4)
    tangents = jnp.asarray(np.outer(np.arange(count), [0.1, 0, 0.02, 0, 0.05, 0]), jnp.float32)
    poses = se3.to_matrices(se3.exp(tangents))
    pairs = [(a, b) for b in range(count) for a in range(max(0, b - REACH), b)]
    errors = rng.multivariate_normal(np.zeros(6), covariance, len(pairs))
    # Short motions commute nearly, so that the errors around a cycle simply add up.
    return replace(slam.init(room.camera, config).graph, edges=edges_with(errors, pairs, poses))


@pytest.fixture(scope="module")
def graph(truth, room, config):
    return on_an_arc(room, config, truth, COUNT)


def test_keyframes_of_other_maps_close_no_cycles(graph, config):
    """One cycle and two maps of two keyframes tell what the cycle alone tells."""
    poses = np.tile(np.eye(4), (7, 1, 1))
    errors, pairs = (
        0.002 * np.random.default_rng(5).normal(size=(5, 6)),
        [(0, 1), (1, 2), (0, 2), (3, 4), (5, 6)],
    )
    alone, beside = (
        edge_noise(replace(graph, edges=edges_with(errors[:count], pairs[:count], poses)), config.graph)
        for count in (3, 5)
    )
    np.testing.assert_allclose(beside.covariance, alone.covariance, rtol=1e-6)
    assert beside.redundancy == pytest.approx(5 / 4)


def test_the_cycles_tell_the_covariance(graph, truth, config):
    """All its directions, to a third of their deviations, from three times as many edges as keyframes."""
    noise = edge_noise(graph, config.graph)
    assert noise.redundancy == pytest.approx(len(graph.edges) / (COUNT - 1))
    root = np.linalg.inv(np.linalg.cholesky(truth))
    ratios = np.sqrt(np.linalg.eigvalsh(root @ noise.covariance @ root.T))
    assert 0.67 < ratios.min() < ratios.max() < 1.33


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0])
def test_few_cycles_tell_its_size(truth, room, config, size):
    """The settings are off by up to twenty times; a dozen keyframes know better."""
    graph = on_an_arc(room, config, size**2 * truth, 12)
    found, usual = edge_noise(graph, config.graph).covariance, prior_noise(config.graph).covariance
    sizes = [np.sqrt(np.trace(np.linalg.solve(usual, covariance))) for covariance in (found, truth)]
    assert sizes[0] / sizes[1] == pytest.approx(size, rel=0.3)


def test_wrong_edges_tell_little(graph, config, rng):
    """Four edges in a hundred and fifty are off by half a metre."""
    off = se3.exp(jnp.asarray([0.5, 0, 0, 0, 0, 0.2]))
    edges = list(graph.edges)
    for number in rng.choice(len(edges), 4, replace=False):
        motion = se3.compose(jaxlie.SE3(jnp.asarray(edges[number].surface_motion)), off)
        edges[number] = replace(edges[number], surface_motion=np.asarray(motion.wxyz_xyz))
    before, after = (
        np.sqrt(np.diag(edge_noise(replace(graph, edges=tuple(e)), config.graph).covariance))
        for e in (graph.edges, edges)
    )
    assert (after < 2 * before).all()


def test_without_cycles_the_settings_hold(graph, config):
    chain = replace(graph, edges=tuple(e for e in graph.edges if e.source - e.target == 1))
    noise = edge_noise(chain, config.graph)
    assert noise.redundancy == 1
    np.testing.assert_array_equal(noise.covariance, prior_noise(config.graph).covariance)
    sigmas = np.repeat([config.graph.edge_sigma_metres, config.graph.edge_sigma_radians], 3)
    np.testing.assert_allclose(np.sqrt(np.diag(noise.covariance)), sigmas)


def test_what_is_open_about_the_sensors_widens_all_edges(room, config, graph):
    """A keyframe at rest, and one that turned by 0.5 rad/s while a delay was known to 4 ms; depth to 1 mm."""
    tracking = replace(config.tracking, estimate_timing=True, estimate_depth=True)
    state = slam.init(room.camera, replace(config, tracking=tracking))
    turning = np.asarray([0, 0, 0, 0, 0.5, 0], np.float32)
    resting = Keyframe(
        features=feature_shapes(state.params),
        landmarks=np.full(4, -1),
        frame=0,
        reference=0,
        T_reference_keyframe=graph.edges[0].T_target_source,
        depth_parameters=state.graph.depth_parameters,
        twist=np.zeros(6, np.float32),
        times=np.zeros(3, np.float32),
        edition=0,
    )
    free = np.zeros((6, len(state.graph.depth_parameters)))
    edge = replace(
        graph.edges[0],
        depth_parameters=state.graph.depth_parameters,
        sensitivity=free,
        surface_sensitivity=free,
    )
    alone = replace(
        state.graph,
        keyframes=(resting, replace(resting, twist=turning)),
        edges=(edge,),
        times_covariance=np.zeros((3, 3)),
    )
    known = edge_noise(alone, config.graph).covariance
    np.testing.assert_array_equal(known, prior_noise(config.graph).covariance)
    late = replace(alone, times_covariance=np.diag([0.004**2, 0, 0]))
    more = edge_noise(late, config.graph).covariance - known
    np.testing.assert_allclose(np.diag(more), [0, 0, 0, 0, (0.5 * 0.004) ** 2, 0], atol=1e-12)
    # The mean of the offsets moves the camera by a metre for each 1/m; by the prior they err on their own.
    moving, count = free.copy(), len(state.graph.depth_parameters) - 6
    moving[2, :count] = 1 / count
    bent = replace(alone, edges=(replace(edge, sensitivity=moving),))
    prior = prior_of(tracking).information
    wide, narrow = (
        edge_noise(replace(bent, depth_covariance=np.linalg.inv(information)), config.graph).covariance[2, 2]
        - known[2, 2]
        for information in (prior, prior + 1e6 * np.eye(len(prior)))
    )
    np.testing.assert_allclose(np.sqrt(wide), state.config.tracking.depth_sigma / np.sqrt(count), rtol=0.01)
    assert narrow < 0.05 * wide


def test_an_edge_adds_its_share(truth):
    """Covariances add up, free directions stay free, and two equal edges say as much as one."""
    noise = EdgeNoise(truth, 2.0)
    known, wall = 1e6 * np.eye(6), np.diag([0, 0, 1e6, 1e6, 1e6, 0])
    shares = noise.share(np.stack([known, wall]))
    np.testing.assert_allclose(np.linalg.inv(2 * shares[0]), 1e-6 * np.eye(6) + truth, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(shares[1][[0, 1, 5]], 0, atol=1e-3)
    assert np.linalg.matrix_rank(shares[1], tol=1.0) == 3


def test_a_pose_by_the_motion_model_has_its_deviation(truth):
    noise = EdgeNoise(truth, 1.0)
    wall = replace(
        registration(se3.identity()),
        surface_information=jnp.diag(jnp.asarray([0, 0, 1e6, 1e6, 1e6, 0])),
        source=jnp.asarray(int(slam.PoseSource.MOTION_MODEL)),
    )
    sigmas = np.sqrt(np.diag(motion_covariance(wall, noise, 0.1)))
    np.testing.assert_allclose(sigmas[[0, 1, 5]], 0.1, rtol=0.01)
    np.testing.assert_allclose(sigmas[2:5], np.sqrt(1e-6 + np.diag(truth)[2:5]), rtol=0.01)


def test_covariances_are_at_least_the_anchors(rng):
    """Of three keyframes the last was known well by others; the anchor's turn moves the second sideways."""
    found = np.zeros((3, 6, 6))
    found[1:] = np.diag(np.full(6, 1e-6))
    before = np.stack([np.diag([1e-6] * 3 + [1e-4] * 3), np.eye(6), np.diag(np.full(6, 1e-7))])
    poses = np.tile(np.asarray([1, 0, 0, 0, 0, 0, 0], float), (3, 1))
    poses[1, 4:] = [0, 0, 2.0]
    after = covariances_in_world(found, poses, before, 0)
    np.testing.assert_allclose(np.diag(after[1]), [4e-4 + 2e-6] * 2 + [2e-6] + [1e-4 + 1e-6] * 3, rtol=1e-6)
    np.testing.assert_array_equal(after[2], before[2])
    world = covariances_in_world(found, poses, np.concatenate([np.zeros((1, 6, 6)), before[1:]]), 0)
    np.testing.assert_array_equal(world, found)
