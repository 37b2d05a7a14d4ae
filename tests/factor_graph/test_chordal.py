"""The start of a pose graph that two linear problems give."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph import (
    FactorGraph,
    PosePrior,
    RelativePose,
    Values,
    chordal_start,
    cost,
    solve,
    spanning_tree_start,
)
from sfgs_jax.factor_graph.start import nearest_rotations
from sfgs_jax.geometry import se3
from tests.factor_graph.graphs import between, eye, perturb, random_poses


def anywhere(rng, n: int = 12):
    """Exact motions between random poses, and those poses."""
    truth = random_poses(rng, n, 1.0)
    chain = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
    ends = np.concatenate([chain, [[0, 7], [11, 2], [4, 9]]])
    return RelativePose(ends, between(truth, ends), eye(100.0, 400.0)), Values(truth)


@pytest.mark.parametrize("solver", ["dense", "sparse", "pcg"])
def test_exact_motions_give_the_exact_poses_from_any_start(float64, rng, solver):
    edges, truth = anywhere(rng)
    prior = PosePrior([5], jaxlie.SE3(truth.poses.wxyz_xyz[5:6]), eye(50.0, 50.0))
    free = np.arange(12) != 3
    graph = FactorGraph([prior, edges], num_poses=12, free_poses=free, linear_solver=solver)
    elsewhere = random_poses(rng, 12, 2.0).wxyz_xyz
    start = Values(jaxlie.SE3(jnp.where(free[:, None], elsewhere, truth.poses.wxyz_xyz)))
    found = chordal_start(graph, start)
    # The damping, and where conjugate gradients stop.
    tolerance = 1e-2 if solver == "pcg" else 1e-4
    off = se3.log(se3.compose(se3.inverse(truth.poses), found.poses))
    np.testing.assert_allclose(off, np.zeros((12, 6)), atol=tolerance)
    np.testing.assert_allclose(found.poses.wxyz_xyz[3], truth.poses.wxyz_xyz[3], atol=1e-12)


def helix(rng, turns: int, around: int, noise: float):
    """Poses wound round a long tube, from their odometry, which noise leads astray."""
    n = turns * around
    angle = 2 * np.pi * np.arange(n) / around
    matrices = np.tile(np.eye(4), (n, 1, 1))
    matrices[:, 0, 0] = matrices[:, 1, 1] = np.cos(angle)
    matrices[:, 1, 0], matrices[:, 0, 1] = np.sin(angle), -np.sin(angle)
    matrices[:, :3, 3] = np.stack([np.sin(angle), -np.cos(angle), 0.1 * np.arange(n) / around], axis=1)
    truth = jaxlie.SE3(jnp.stack([se3.from_matrix(m, jnp.result_type(float)).wxyz_xyz for m in matrices]))
    steps = np.arange(n)
    ends = np.concatenate([np.stack([steps[:-k], steps[k:]], axis=1) for k in (1, around)])
    edges = RelativePose(ends, perturb(between(truth, ends), rng, noise), eye(noise**-2, noise**-2))
    return edges, spanning_tree_start(edges, n)


def test_a_solve_takes_few_steps_from_there_and_an_optimum_is_left_alone(rng):
    edges, odometry = helix(rng, 12, 10, 0.1)
    graph = FactorGraph([edges], num_poses=120, free_poses=np.arange(120) > 0)
    start = chordal_start(graph, odometry)
    best, slow = solve(graph, start), solve(graph, odometry)
    np.testing.assert_allclose(best.cost, slow.cost, rtol=1e-4)
    assert cost(graph, start) < 1.2 * best.cost
    assert 5 * best.cost < cost(graph, odometry)
    assert best.iterations < slow.iterations
    kept = chordal_start(graph, best.values)
    np.testing.assert_array_equal(kept.poses.wxyz_xyz, best.values.poses.wxyz_xyz)


def test_fixed_masked_and_unconnected_poses_stay(rng):
    edges, truth = anywhere(rng)
    pad = np.array([[0, 5], [99, -3]])
    ends = np.concatenate([edges.poses, pad])
    measured = jnp.concatenate([edges.T_a_b.wxyz_xyz, jnp.full((2, 7), jnp.nan)])
    matrices = jnp.concatenate([edges.matrices, jnp.full((2, 6, 6), jnp.nan)])
    padded = RelativePose(ends, jaxlie.SE3(measured), matrices, valid=np.arange(len(ends)) < len(ends) - 2)
    # Two more poses that see each other alone: nothing says where they are.
    alone = RelativePose([[12, 13]], jaxlie.SE3(edges.T_a_b.wxyz_xyz[:1]), eye(1.0, 1.0))
    extra = random_poses(rng, 3, 1.0).wxyz_xyz
    start = Values(
        jaxlie.SE3(jnp.concatenate([truth.poses.wxyz_xyz[:1], random_poses(rng, 11).wxyz_xyz, extra]))
    )
    graph = FactorGraph([padded, alone], num_poses=15, free_poses=np.arange(15) > 0)
    found = chordal_start(graph, start).poses.wxyz_xyz
    assert np.all(np.isfinite(found))
    np.testing.assert_array_equal(found[0], truth.poses.wxyz_xyz[0])
    np.testing.assert_array_equal(found[12:, :4], start.poses.wxyz_xyz[12:, :4])
    np.testing.assert_array_equal(found[14], start.poses.wxyz_xyz[14])
    np.testing.assert_allclose(found[:12, 4:], truth.poses.wxyz_xyz[:, 4:], atol=1e-3)

    empty = FactorGraph([], num_poses=15)
    np.testing.assert_array_equal(chordal_start(empty, start).poses.wxyz_xyz, start.poses.wxyz_xyz)
    with pytest.raises(InputError, match="the graph 14 and 0"):
        chordal_start(FactorGraph([], num_poses=14), start)


def test_the_nearest_rotation_is_that_of_the_singular_vectors(float64, rng):
    matrices = rng.normal(size=(50, 3, 3)) * 10.0 ** rng.uniform(-30, 5, (50, 1, 1))
    found, proper = jax.jit(nearest_rotations)(jnp.asarray(matrices))
    u, _, vt = np.linalg.svd(matrices)
    np.testing.assert_array_equal(proper, np.linalg.det(u @ vt) > 0)
    np.testing.assert_allclose(found[proper], (u @ vt)[proper], atol=1e-9)
