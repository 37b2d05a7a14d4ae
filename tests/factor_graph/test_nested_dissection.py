"""Vertex separators of graphs."""

from itertools import product

import numpy as np
import scipy.sparse as sparse

from sfgs_jax.factor_graph.problem import minimum_vertex_cover


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
