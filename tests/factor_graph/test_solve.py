"""Solvers against a dense float64 solve, known answers, growth without compiling, and hopeless input."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph import (
    CustomFactor,
    FactorGraph,
    PosePrior,
    RelativePose,
    Reprojection,
    SolverConfig,
    Status,
    Values,
    cost,
    marginal_covariances,
    retract,
    solve,
    solve_implicit,
)
from sfgs_jax.factor_graph.solver import build_normal_equations, compute_step, symmetric_rank_k_blocks
from sfgs_jax.geometry import se3
from tests.factor_graph.graphs import CAMERA, blocks_of_bundle, blocks_of_ring, bundle, eye, ring

# One program instead of one for each operation.
cost_of = jax.jit(cost)

SOLVERS = ("dense", "sparse", "pcg")
EXACT = SolverConfig(pcg_tolerance=1e-7, pcg_max_iterations=500)
# Settings are static: tests that ask for an optimum to all digits of float64 ask for it in one way.
TO_THE_LAST_DIGIT = SolverConfig(cost_tolerance=1e-12)


@jax.jit
def whitened(graph, values):
    """Jacobian of all whitened residuals, by automatic differentiation, and the residuals."""
    P, L = graph.num_poses, graph.num_landmarks

    def residuals(flat):
        moved = retract(values, flat[: 6 * P].reshape(P, 6), flat[6 * P :].reshape(L, 3))
        parts = []
        for factor in graph.factors:
            r, information = factor.residuals(moved)
            if information is not None:
                root = jnp.linalg.cholesky(jnp.moveaxis(information, -1, 0))
                r = jnp.einsum("nji,jn->in", root, r)
            parts.append(r.reshape(-1))
        r = jnp.concatenate(parts)
        return r, r

    return jax.jacfwd(residuals, has_aux=True)(jnp.zeros(6 * P + 3 * L))


def dense_hessian(graph, values):
    """Gauss-Newton Hessian and gradient."""
    J, r = (np.asarray(x) for x in whitened(graph, values))
    return J.T @ J, J.T @ r


@jax.jit
def step_from(graph, values, damping):
    return compute_step(graph, build_normal_equations(graph, values), damping, EXACT)


def finite(tree) -> bool:
    return all(bool(np.all(np.isfinite(leaf))) for leaf in jax.tree.leaves(tree))


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("make", [bundle, ring])
def test_a_step_is_that_of_a_dense_solve(float64, rng, make, solver):
    graph, start, _ = make(rng, linear_solver=solver)
    damping = 1e-3
    step = step_from(graph, start, jnp.asarray(damping))
    H, g = dense_hessian(make(np.random.default_rng(0))[0], start)
    expected = -np.linalg.solve(H + damping * np.diag(np.diag(H)), g)
    found = np.concatenate([step.poses.reshape(-1), step.landmarks.reshape(-1)])
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-8)
    np.testing.assert_allclose(step.expected, -(g @ found) - found @ H @ found / 2, rtol=1e-6)


@pytest.mark.parametrize("used", [7, 8, 26])
def test_room_for_poses_to_come_changes_no_step(float64, rng, used):
    graph, start, _ = ring(rng, n=used, linear_solver="dense")
    room = 50
    wide = FactorGraph(
        graph.factors, num_poses=room, free_poses=np.arange(room) < used, linear_solver="dense"
    )
    poses = np.pad(start.poses.wxyz_xyz, ((0, room - used), (0, 0)), mode="edge")
    damping = jnp.asarray(1e-3)
    step = step_from(wide, Values(jaxlie.SE3(jnp.asarray(poses))), damping)
    np.testing.assert_allclose(
        step.poses[:used], step_from(graph, start, damping).poses, rtol=1e-6, atol=1e-9
    )
    np.testing.assert_array_equal(step.poses[used:], 0)


@pytest.mark.parametrize(
    ("method", "solver"),
    [*(("levenberg_marquardt", solver) for solver in SOLVERS), ("gauss_newton", "dense")],
)
def test_every_solver_reaches_the_float64_optimum(rng, solver, method):
    graph, start, _ = bundle(rng, linear_solver=solver)
    solution = solve(graph, start, SolverConfig(method=method))
    assert solution.status == Status.CONVERGED
    with jax.enable_x64(True):
        rng = np.random.default_rng(0)
        graph, start, _ = bundle(rng)
        best = solve(graph, start, TO_THE_LAST_DIGIT)
    np.testing.assert_allclose(solution.cost, best.cost, rtol=1e-4)
    np.testing.assert_allclose(solution.values.landmarks, best.values.landmarks, atol=2e-3)


def test_a_long_graph_is_dissected_and_solved_and_grows_without_compiling(rng, compilations):
    whole, start, truth = ring(rng, n=140, noise=0.003, loops=20)
    prior, edges = blocks_of_ring(whole)
    before = edges.poses.max(axis=1) < 139
    fewer = RelativePose(edges.poses, edges.T_a_b, edges.matrices, valid=before)
    first = FactorGraph([prior, fewer], num_poses=140, free_poses=np.arange(140) < 139)
    assert first.linear_solver == "sparse"
    assert len(first.plan.batches) > 5
    # A batch that hands nothing up would be factorised beside the next, which can deadlock LAPACK's threads.
    assert all(boundary > 0 for _, boundary in first.plan.sizes[:-1])
    assert solve(first, start).status == Status.CONVERGED
    graph = FactorGraph([prior, edges], num_poses=140, capacities=first.capacities)
    compiled = len(compilations)
    solution = solve(graph, start)
    assert len(compilations) == compiled
    assert solution.status == Status.CONVERGED
    with jax.enable_x64(True):
        graph, start, _ = ring(np.random.default_rng(0), n=140, noise=0.003, loops=20, linear_solver="dense")
        best = solve(graph, start, TO_THE_LAST_DIGIT)
    np.testing.assert_allclose(solution.cost, best.cost, rtol=1e-3)
    error = np.asarray(solution.values.poses.wxyz_xyz - truth.poses.wxyz_xyz)[:, 4:]
    assert np.sqrt(np.mean(error**2)) < 0.1


def test_a_triangle_is_put_together_from_strips(rng):
    rows = rng.normal(size=(3, 30, 12)).astype(np.float32)
    whole = np.einsum("nis,njs->nij", rows, rows).reshape(3, 5, 6, 5, 6).transpose(0, 1, 3, 2, 4)
    expected = whole[:, *np.tril_indices(5)]
    found = jax.jit(partial(symmetric_rank_k_blocks, blocks=5, strip=2))(rows)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_statistics_tell_what_happened(rng):
    graph, start, _ = bundle(rng)
    solution = solve(graph, start)
    n = int(solution.iterations)
    costs = np.asarray(solution.statistics.cost)
    np.testing.assert_allclose(costs[0], cost_of(graph, start), rtol=1e-5)
    assert np.all(np.diff(costs[:n]) <= 0)
    assert np.all(np.isnan(costs[n:]))
    assert bool(solution.statistics.accepted[0])
    assert solution.cost <= costs[n - 1]
    assert solve(graph, start, SolverConfig(max_iterations=1)).status == Status.MAX_ITERATIONS


def test_fixed_variables_stay(rng):
    free_poses, free_landmarks = np.ones(6, bool), np.ones(40, bool)
    free_poses[[0, 3]], free_landmarks[5] = False, False
    graph, start, _ = bundle(rng, free_poses=free_poses, free_landmarks=free_landmarks)
    solution = solve(graph, start)
    assert solution.status == Status.CONVERGED
    found, begun = (np.asarray(values.poses.wxyz_xyz)[~free_poses] for values in (solution.values, start))
    np.testing.assert_allclose(found, begun, atol=1e-6)
    found, begun = (np.asarray(values.landmarks) for values in (solution.values, start))
    np.testing.assert_array_equal(found[5], begun[5])
    assert np.all(np.any(found != begun, axis=1)[free_landmarks])


def growing(rng, poses: int, observations: int, capacities=None):
    graph, start, _ = bundle(rng, poses=8, landmarks=60)
    prior, chain, seen = blocks_of_bundle(graph)
    room = 600 - len(seen.valid)

    def pad(x) -> np.ndarray:
        return np.concatenate([np.asarray(x), np.zeros((room, *x.shape[1:]), x.dtype)])

    valid = pad(seen.valid) & (np.arange(600) < observations) & (pad(seen.poses)[:, 0] < poses)
    pixels = jnp.asarray(np.where(valid[:, None], pad(seen.pixels), np.nan))
    seen = Reprojection(pad(seen.poses)[:, 0], pad(seen.landmarks), pixels, CAMERA, valid=valid)
    chain = RelativePose(chain.poses, chain.T_a_b, chain.matrices, valid=chain.poses[:, 1] < poses)
    touched = np.zeros(60, bool)
    touched[np.asarray(seen.landmarks)[valid]] = True
    graph = FactorGraph(
        [prior, chain, seen],
        num_poses=8,
        num_landmarks=60,
        free_poses=np.arange(8) < poses,
        free_landmarks=touched,
        capacities=capacities,
    )
    return graph, start


def test_a_graph_that_grows_does_not_compile_again(compilations):
    graph, start = growing(np.random.default_rng(0), 7, 250)
    first = solve(graph, start)
    bigger, start = growing(np.random.default_rng(0), 8, 330, graph.capacities)
    compilations.clear()
    second = solve(bigger, start)
    assert not compilations
    assert first.status == second.status == Status.CONVERGED
    assert finite(first.values)
    assert np.any(first.values.poses.wxyz_xyz[7] != second.values.poses.wxyz_xyz[7])


def test_many_small_graphs_at_once():
    made = [ring(np.random.default_rng(seed), n=6, loops=1) for seed in range(4)]
    graphs, starts, _ = (jax.tree.map(lambda *x: np.stack(x), *each) for each in zip(*made, strict=True))
    together = jax.vmap(solve)(graphs, starts)
    for i, (graph, start, _) in enumerate(made):
        alone = solve(graph, start)
        assert together.status_code[i] == alone.status
        np.testing.assert_allclose(together.cost[i], alone.cost, rtol=1e-3)


@pytest.mark.parametrize("method", ["levenberg_marquardt", "gauss_newton"])
def test_what_nothing_determines_is_called_singular(rng, method):
    config = SolverConfig(method=method)
    # One of the rings that are solved together: its program is there already.
    graph, start, _ = ring(rng, n=6, loops=1)
    poses = jaxlie.SE3(jnp.concatenate([start.poses.wxyz_xyz, start.poses.wxyz_xyz[-1:]]))
    alone = FactorGraph(graph.factors, num_poses=7)
    solution = solve(alone, Values(poses), config)
    assert solution.status == Status.SINGULAR
    assert finite(solution.values)
    np.testing.assert_allclose(solution.values.poses.wxyz_xyz[6], poses.wxyz_xyz[6], atol=1e-6)
    np.testing.assert_allclose(solution.cost, solve(graph, start, config).cost, rtol=1e-2, atol=1e-3)

    empty = solve(FactorGraph([], num_poses=2), Values(jaxlie.SE3(poses.wxyz_xyz[:2])), config)
    assert empty.status == Status.SINGULAR
    assert empty.cost == 0


def test_a_landmark_seen_once_goes_to_its_ray(rng):
    prior = PosePrior([0], se3.exp(jnp.zeros((1, 6))), eye(1e6, 1e6))
    seen = Reprojection([0], [0], jnp.asarray([[330.0, 250.0]]), CAMERA)
    graph = FactorGraph([prior, seen], num_poses=1, num_landmarks=1)
    start = Values(se3.exp(jnp.zeros((1, 6))), jnp.asarray([[0.1, 0.1, 2.0]]))
    solution = solve(graph, start)
    assert solution.status == Status.CONVERGED
    # How far along the ray is nobody's measurement: the damping alone decides it.
    landmark = solution.values.landmarks[0]
    assert landmark[2] > 0.5
    np.testing.assert_allclose(landmark / landmark[2], [0.02, 0.0196, 1.0], atol=1e-4)
    undamped = solve(graph, start, SolverConfig(method="gauss_newton"))
    assert undamped.status == Status.SINGULAR
    assert finite(undamped.values)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_landmark_behind_the_cameras_stays_and_spoils_nothing(rng, solver):
    graph, start, _ = bundle(rng, linear_solver=solver)
    behind = Values(start.poses, start.landmarks.at[3, 2].set(-2.0))
    solution = solve(graph, behind)
    assert solution.status == Status.SINGULAR
    np.testing.assert_array_equal(solution.values.landmarks[3], behind.landmarks[3])
    # The others end where they do without it.
    prior, chain, seen = blocks_of_bundle(graph)
    landmarks = np.asarray(seen.landmarks)
    without = Reprojection(seen.poses[:, 0], landmarks, seen.pixels, CAMERA, valid=landmarks != 3)
    fewer = FactorGraph([prior, chain, without], num_poses=6, num_landmarks=40, linear_solver=solver)
    expected = solve(fewer, behind).values
    np.testing.assert_allclose(solution.values.poses.wxyz_xyz, expected.poses.wxyz_xyz, atol=2e-3)
    np.testing.assert_allclose(solution.values.landmarks, expected.landmarks, atol=1e-2)


def test_nothing_moves_where_all_is_fixed_and_blocks_may_be_empty(rng):
    graph, start, _ = bundle(rng, free_poses=np.zeros(6, bool), free_landmarks=np.zeros(40, bool))
    solution = solve(graph, start)
    assert solution.status == Status.CONVERGED
    np.testing.assert_array_equal(solution.values.poses.wxyz_xyz, start.poses.wxyz_xyz)
    np.testing.assert_array_equal(solution.values.landmarks, start.landmarks)
    np.testing.assert_allclose(solution.cost, cost_of(graph, start), rtol=1e-5)
    none = RelativePose(np.zeros((0, 2), int), jaxlie.SE3(jnp.zeros((0, 7))), eye(1.0, 1.0))
    prior = PosePrior([0], jaxlie.SE3(start.poses.wxyz_xyz[:1]), eye(1.0, 1.0))
    alone = solve(FactorGraph([none, prior], num_poses=1), Values(jaxlie.SE3(start.poses.wxyz_xyz[1:2])))
    assert alone.status == Status.CONVERGED
    np.testing.assert_allclose(alone.values.poses.wxyz_xyz, start.poses.wxyz_xyz[:1], atol=1e-5)


def test_a_measurement_that_is_not_finite_diverges_and_changes_nothing(rng):
    graph, start, _ = bundle(rng)
    prior, chain, seen = blocks_of_bundle(graph)
    pixels = seen.pixels.at[3].set(jnp.nan)
    broken = Reprojection(seen.poses[:, 0], np.asarray(seen.landmarks), pixels, CAMERA)
    solution = solve(FactorGraph([prior, chain, broken], num_poses=6, num_landmarks=40), start)
    assert solution.status == Status.DIVERGED
    np.testing.assert_array_equal(solution.values.landmarks, start.landmarks)


def test_indices_out_of_range_are_refused(rng):
    graph, start, _ = ring(rng)
    with pytest.raises(InputError, match="touches pose 19"):
        FactorGraph(graph.factors, num_poses=10)
    with pytest.raises(InputError, match="20 poses"):
        solve(FactorGraph(graph.factors, num_poses=21), start)


def test_poses_may_be_matrices(rng):
    graph, start, _ = ring(rng)
    prior, chain = blocks_of_ring(graph)
    places, motions, known = map(se3.to_matrices, (start.poses, chain.T_a_b, prior.T_world_pose))
    again = (
        Values(places).poses,
        RelativePose(chain.poses, motions, chain.matrices).T_a_b,
        PosePrior(prior.poses[:, 0], known, prior.matrices).T_world_pose,
    )
    for found, given in zip(again, (places, motions, known), strict=True):
        np.testing.assert_allclose(se3.to_matrices(found), given, atol=1e-6)


def test_marginals_are_blocks_of_the_inverse(float64, rng):
    graph, start, _ = bundle(rng)
    values = solve(graph, start, TO_THE_LAST_DIGIT).values
    covariance = np.linalg.inv(dense_hessian(graph, values)[0])
    found = marginal_covariances(graph, values, poses=np.array([0, 4]), landmarks=np.array([7]))
    for block, pose in zip(found.poses, (0, 4), strict=True):
        at = slice(6 * pose, 6 * pose + 6)
        np.testing.assert_allclose(block, covariance[at, at], rtol=1e-6, atol=1e-12)
    at = slice(36 + 21, 36 + 24)
    np.testing.assert_allclose(found.landmarks[0], covariance[at, at], rtol=1e-6, atol=1e-12)


def quickly(function):
    """Compiled with few optimisations: each of these programs runs a few times for milliseconds."""
    return jax.jit(function, compiler_options={"xla_backend_optimization_level": 0})


def scaled_range(row, poses, landmark):
    return row["weight"] * (jnp.linalg.norm(poses.wxyz_xyz[0, 4:] - landmark) - row["range"])[None]


def test_implicit_gradients_are_those_of_finite_differences_and_of_unrolling(float64, rng):
    # Every camera sees every point: where nothing determines a depth, it has no derivative.
    base, start, _ = bundle(rng, poses=3, landmarks=8, share=1.0)

    def graph(change, weight):
        _, chain, seen = blocks_of_bundle(base)
        # Moved on the group: Jacobians in closed form hold for rotations alone.
        chain = RelativePose(chain.poses, se3.compose(chain.T_a_b, se3.exp(change)), chain.matrices)
        rows = {"range": jnp.full(2, 3.1), "weight": weight}
        ranges = CustomFactor(scaled_range, [1, 2], rows, landmarks=[0, 1])
        return FactorGraph([chain, seen, ranges], num_poses=3, num_landmarks=8, free_poses=np.arange(3) > 0)

    def outcome(values):
        return jnp.sum(values.landmarks[:, 2] ** 2) + jnp.sum(values.poses.wxyz_xyz[2, 4:])

    # Levenberg-Marquardt ends where rounding hides a lower cost, which is at half the digits of the optimum.
    exact = SolverConfig("gauss_newton", cost_tolerance=0.0, step_tolerance=1e-12, max_iterations=40)
    unrolled = SolverConfig(cost_tolerance=0.0, step_tolerance=0.0, max_iterations=12, unrolled=True)
    arguments = jnp.zeros((2, 6)), jnp.asarray([3.0, 5.0])

    @quickly
    def solved(arguments, directions):
        """The outcome, its rates along directions in forward mode, and its gradient in reverse mode."""
        value, rate = jax.linearize(lambda *a: outcome(solve_implicit(graph(*a), start, exact)), *arguments)
        (gradient,) = jax.linear_transpose(lambda a: rate(*a), arguments)(jnp.ones_like(value))
        return value, jax.vmap(rate)(*directions), gradient

    # The first moves the one argument, the second the other.
    directions = tuple(
        jnp.asarray(rng.normal(size=(2, *a.shape))).at[1 - index].set(0) for index, a in enumerate(arguments)
    )
    _, forward, implicit = solved(arguments, directions)
    unroll = quickly(jax.grad(lambda *a: outcome(solve(graph(*a), start, unrolled).values), (0, 1)))
    through = unroll(*arguments)
    for index in range(2):
        ends = []
        for sign in (1e-5, -1e-5):
            shifted = tuple(a + sign * d[index] for a, d in zip(arguments, directions, strict=True))
            ends.append(solved(shifted, directions)[0])
        expected = (ends[0] - ends[1]) / 2e-5
        moved = directions[index][index]
        np.testing.assert_allclose(jnp.vdot(implicit[index], moved), expected, rtol=1e-6)
        np.testing.assert_allclose(forward[index], expected, rtol=1e-6)
        np.testing.assert_allclose(jnp.vdot(through[index], moved), expected, rtol=1e-3)
