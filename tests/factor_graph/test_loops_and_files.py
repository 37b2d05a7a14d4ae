"""False loop closures, g2o files, pictures."""

import jax.numpy as jnp
import jaxlie
import numpy as np
import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.factor_graph import (
    FactorGraph,
    PoseGraph,
    RelativePose,
    Status,
    Values,
    consistent_loops,
    cost,
    plot_graph,
    read_g2o,
    solve,
    spanning_tree_start,
    within_threshold,
    write_g2o,
)
from sfgs_jax.geometry import quaternions_from_rotations, se3
from tests.factor_graph.graphs import blocks_of_ring, compose, exp, eye, inverse, random_poses, ring

NOISE = 0.01


@pytest.fixture
def corrupted(rng):
    """A ring with 14 true closures and 6 false ones: prior, chain, closures, false, start, truth."""
    graph, start, truth = ring(rng, n=40, noise=NOISE, loops=14)
    prior, edges = blocks_of_ring(graph)
    chain, loops = slice(0, 39), slice(39, None)
    false = np.zeros(20, bool)
    false[14:] = True
    ends = np.concatenate([edges.poses[loops], rng.integers(0, 40, (6, 2))])
    measured = np.concatenate([edges.T_a_b.wxyz_xyz[loops], random_poses(rng, 6, 0.5).wxyz_xyz])
    odometry = RelativePose(edges.poses[chain], jaxlie.SE3(edges.T_a_b.wxyz_xyz[chain]), eye(1e4, 1e4))
    return prior, odometry, (ends, jaxlie.SE3(jnp.asarray(measured))), false, start, truth


def motions_of(matrices) -> jaxlie.SE3:
    wxyz = quaternions_from_rotations(matrices[:, :3, :3])
    return jaxlie.SE3(jnp.asarray(np.concatenate([wxyz, matrices[:, :3, 3]], axis=1), jnp.float32))


def error(values, truth) -> float:
    offset = np.asarray(values.poses.wxyz_xyz - truth.poses.wxyz_xyz)[:, 4:]
    return float(np.sqrt(np.mean(np.sum(offset**2, axis=1))))


def solved(prior, odometry, closures, start, **options):
    ends, measured = closures
    loops = RelativePose(ends, measured, eye(1e4, 1e4), **options)
    return solve(FactorGraph([prior, odometry, loops], num_poses=40), start).values


def test_thirty_percent_of_false_loops_hardly_matter(corrupted):
    prior, odometry, closures, false, start, truth = corrupted
    without = error(solved(prior, odometry, closures, start, valid=~false), truth)
    naive = error(solved(prior, odometry, closures, start), truth)
    assert naive > 3 * without
    ends, measured = closures
    loops = RelativePose(ends, measured, eye(1e4, 1e4))
    kept = consistent_loops(loops, start)
    np.testing.assert_array_equal(kept, ~false)
    robust = solved(
        prior,
        odometry,
        closures,
        start,
        valid=kept,
        kernel="dynamic_covariance_scaling",
        kernel_width=3.0,
    )
    assert error(robust, truth) < 1.1 * without
    np.testing.assert_array_equal(within_threshold(loops, robust, max_square=30.0), ~false)


@pytest.mark.parametrize("ends", [[[0, 29], [4, 20]], [[3, 12], [27, 15]], [[2, 18], [11, 25]]])
def test_true_loops_disagree_as_seldom_as_chance_has_it(rng, ends):
    """Nested, one after the other, and overlapping; the odometry drifts by much more than a loop is off."""
    steps = random_poses(rng, 29, 0.3)
    sigma = np.repeat([0.03, 0.02], 3)
    matrices = jnp.asarray(np.diag(sigma**-2.0))

    def chain(steps):
        poses = [np.eye(4)]
        for step in se3.to_matrices(steps):
            poses.append(poses[-1] @ step)
        return np.array(poses)

    def noisy(motions):
        noise = rng.normal(size=(len(motions.wxyz_xyz), 6)) * sigma
        return compose(motions, exp(jnp.asarray(noise, jnp.float32)))

    a, b = chain(steps)[np.array(ends)].swapaxes(0, 1)
    measured = motions_of(np.linalg.inv(a) @ b)
    agreed = []
    for _ in range(200):
        loops = RelativePose(ends, noisy(measured), matrices)
        odometry = Values(motions_of(chain(noisy(steps))))
        # Half of all true pairs lie below the median of chi-square with 6 degrees of freedom.
        agreed.append(consistent_loops(loops, odometry, max_square=5.348).all())
    assert 0.4 < np.mean(agreed) < 0.6


def test_the_kernel_alone_keeps_false_loops_out_too(corrupted):
    prior, odometry, closures, false, start, truth = corrupted
    without = error(solved(prior, odometry, closures, start, valid=~false), truth)
    options = {"kernel": "dynamic_covariance_scaling", "kernel_width": 3.0}
    assert error(solved(prior, odometry, closures, start, **options), truth) < 1.1 * without


def test_g2o_files_come_back(tmp_path, rng):
    graph, start, _ = ring(rng, n=8, loops=2)
    _, edges = blocks_of_ring(graph)
    fixed = np.arange(8) == 0
    written = PoseGraph(start, edges, 10 * np.arange(8), fixed)
    write_g2o(tmp_path / "a.g2o", written)
    read = read_g2o(tmp_path / "a.g2o")
    np.testing.assert_allclose(read.values.poses.wxyz_xyz, start.poses.wxyz_xyz, atol=1e-6)
    np.testing.assert_allclose(read.edges.T_a_b.wxyz_xyz, edges.T_a_b.wxyz_xyz, atol=1e-6)
    np.testing.assert_allclose(read.edges.matrices, edges.matrices, rtol=1e-6)
    np.testing.assert_array_equal(read.edges.poses, edges.poses)
    np.testing.assert_array_equal(read.vertices, written.vertices)
    np.testing.assert_array_equal(read.fixed, fixed)
    again = FactorGraph([read.edges], num_poses=8, free_poses=~read.fixed)
    np.testing.assert_allclose(
        cost(again, read.values), cost(FactorGraph([edges], num_poses=8), start), rtol=1e-3
    )


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1", "line 2 .* .EDGE_SE2. is not one of"),
        ("VERTEX_SE2 1 0 0 0", "line 2 .* .VERTEX_SE2. is not one of .* 3-D poses"),
        ("\x00\xff\xfe", "line 2 .* is not one of"),
        ("EDGE_SE3:QUAT 0 1 1 0 0", "line 2 .* needs other numbers"),
        ("FIX 7", "no VERTEX_SE3:QUAT line for vertex 7"),
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", "line 2 .* there already"),
        ("VERTEX_SE3:QUAT 1 0 0 0 0 0 0 0", "line 2 .* needs other numbers"),
    ],
)
def test_other_g2o_lines_are_refused_with_their_place(tmp_path, line, message):
    path = tmp_path / "b.g2o"
    path.write_bytes(f"VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n{line}\n".encode("latin1"))
    with pytest.raises(InputError, match=message):
        read_g2o(path)


def test_a_picture_is_drawn(tmp_path, rng):
    graph, start, truth = ring(rng)
    plot_graph(graph, start, truth, tmp_path / "graph.png")
    assert (tmp_path / "graph.png").stat().st_size > 10_000


def test_odometry_is_followed_over_gaps_and_against_the_arrow(rng):
    graph, _, truth = ring(rng, n=8, noise=1e-8, loops=1)
    _, edges = blocks_of_ring(graph)
    mask = np.ones(len(edges.valid), bool)
    mask[3] = False  # from 3 to 4: what lies beyond is reached over the loop between 0 and 7
    found = spanning_tree_start(RelativePose(edges.poses, edges.T_a_b, edges.matrices, valid=mask), 9)
    # The first pose of each piece is at the origin, and so is one that nothing touches.
    first = jaxlie.SE3(truth.poses.wxyz_xyz[:1])
    expected = compose(jaxlie.SE3(jnp.tile(inverse(first).wxyz_xyz, (8, 1))), truth.poses)
    np.testing.assert_allclose(found.poses.wxyz_xyz[:8, 4:], expected.wxyz_xyz[:, 4:], atol=1e-5)
    np.testing.assert_allclose(found.poses.wxyz_xyz[8], [1, 0, 0, 0, 0, 0, 0], atol=1e-6)


def test_g2o_files_may_have_edges_alone_gaps_and_rounded_quaternions(tmp_path):
    path = tmp_path / "c.g2o"
    weight = " ".join(["1"] + ["0"] * 20)
    path.write_text(
        "PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n"
        f"EDGE_SE3:QUAT 7 9 1 0 0 0 0 0.7071 0.7071 {weight}\n"
        f"EDGE_SE3:QUAT 40 9 -1 0 0 0 0 0 1 {weight}\nFIX 7\n"
    )
    read = read_g2o(path)
    np.testing.assert_array_equal(read.vertices, [7, 9, 40])
    np.testing.assert_array_equal(read.fixed, [True, False, False])
    np.testing.assert_array_equal(read.edges.poses, [[0, 1], [2, 1]])
    np.testing.assert_allclose(
        read.values.poses.wxyz_xyz[:, 4:], [[0, 0, 0], [1, 0, 0], [1, 1, 0]], atol=1e-6
    )


def test_g2o_lines_come_in_any_order_with_comments_tabs_and_line_ends(tmp_path):
    path = tmp_path / "d.g2o"
    weight = " ".join(["1"] + ["0"] * 20)
    path.write_bytes(
        f"# made by hand\r\nEDGE_SE3:QUAT\t12  -3 1e0 0 0 0 0 0 1 {weight}\r\nFIX 12\r\n\r\n"
        "VERTEX_SE3:QUAT 12 0 0 0 0 0 0 1\r\nVERTEX_SE3:QUAT -3 1.5 0 0 0 0 0 1 # end".encode()
    )
    read = read_g2o(path)
    np.testing.assert_array_equal(read.vertices, [-3, 12])
    np.testing.assert_array_equal(read.fixed, [False, True])
    np.testing.assert_array_equal(read.edges.poses, [[1, 0]])
    np.testing.assert_allclose(read.values.poses.wxyz_xyz[:, 4], [1.5, 0])

    # Poses alone make a graph without factors, which determine nothing.
    path.write_text("VERTEX_SE3:QUAT 5 0 0 0 0 0 0 1\n")
    alone = read_g2o(path)
    solution = solve(FactorGraph([alone.edges], num_poses=1), alone.values)
    assert solution.status == Status.SINGULAR
    path.write_text("")
    with pytest.raises(InputError, match="holds no poses"):
        read_g2o(path)
