"""The sparse solver: vertex separators of graphs, and the calls of LAPACK along a dissection."""

from itertools import product

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
import scipy.sparse as sparse
from jax.extend.core import jaxprs_in_params

from sfgs_jax.factor_graph import Capacities, FactorGraph, RelativePose
from sfgs_jax.factor_graph.problem import minimum_vertex_cover
from sfgs_jax.factor_graph.solver import multifrontal_cholesky, multifrontal_solve


def test_no_fewer_vertices_cover_the_edges_of_a_cut(rng):
    for _ in range(10):
        a, b = rng.integers(0, 10, (2, 14))
        links = np.zeros((10, 10), np.int8)
        links[a[a != b], b[a != b]] = 1
        links |= links.T
        first = rng.uniform(size=10) < 0.5
        across = links * (first[:, None] & ~first)
        chosen = minimum_vertex_cover(sparse.csr_array(links), first)
        assert not across[~chosen][:, ~chosen].any()
        covers = (np.array(c, bool) for c in product([False, True], repeat=10))
        fewest = min(c.sum() for c in covers if not across[~c][:, ~c].any())
        assert chosen.sum() == fewest


def test_a_way_that_grows_keeps_its_plan_until_the_room_is_full(rng):
    """Also that of two poses, for which the solver is compiled ahead."""
    room = 4 * 512
    sizes = set()
    for count in (2, 260, 300, 400, 510):
        back = [np.stack([np.arange(count - step), np.arange(step, count)], axis=1) for step in (1, 2, 3)]
        loops = np.stack([rng.integers(0, count, 5), rng.integers(0, count, 5)], axis=1)
        ends = np.concatenate([*back, loops] if count > 2 else back[:1])
        ends = ends[ends[:, 0] != ends[:, 1]]
        padded = np.tile([[0, 1]], (room, 1))
        padded[: len(ends)] = ends
        edges = RelativePose(
            padded, jaxlie.SE3.identity((room,)), jnp.eye(6), valid=np.arange(room) < len(ends)
        )
        capacities = Capacities.for_trajectory(edges=room)
        plan = FactorGraph([edges], num_poses=512, capacities=capacities, linear_solver="sparse").plan
        assert plan is not None
        sizes.add(plan.sizes)
    assert len(sizes) == 1


def ranks(jaxpr):
    """Ranks of the first operands of all LAPACK calls, those in loops and inner functions included."""
    found = []
    for equation in jaxpr.eqns:
        if equation.primitive.name in ("cholesky", "triangular_solve"):
            found.append(equation.invars[0].aval.ndim)
        for inner in jaxprs_in_params(equation.params):
            found += ranks(inner)
    return found


def test_no_batched_call_of_lapack_holds_a_thread_of_the_pool():
    """Two of them at once, in two programs, waited for each other for ever on two threads."""
    ends = np.stack([np.arange(199), np.arange(1, 200)], axis=1)
    chain = RelativePose(ends, jaxlie.SE3.identity((199,)), jnp.eye(6))
    graph = FactorGraph([chain], num_poses=200, linear_solver="sparse")
    diagonal = np.tile(np.eye(6, dtype=np.float32), (200, 1, 1))
    beside = np.zeros((len(graph.structure.rows), 6, 6), np.float32)
    plan = graph.plan
    assert plan is not None
    assert max(batch.own.shape[0] for batch in plan.batches) > 1

    def solved(diagonal, beside, right):
        return multifrontal_solve(plan, multifrontal_cholesky(plan, diagonal, beside), right)

    found = ranks(jax.make_jaxpr(solved)(diagonal, beside, np.ones((200, 6), np.float32)).jaxpr)
    assert len(found) >= 4
    assert set(found) == {2}
