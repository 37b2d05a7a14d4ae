"""Voxel means, nearest points and neighbourhood covariances against SciPy's tree and plain loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from sfgs_jax.arrays import INDICES, InputError
from sfgs_jax.gicp import clouds
from sfgs_jax.gicp.clouds import occupied_cells

# Each compiled as a whole, as the library does. One by one their operations are a hundred programs a size.
build_hash = jax.jit(clouds.build_hash)
nearest = jax.jit(clouds.nearest, static_argnames="slots")
neighbourhoods = jax.jit(clouds.neighbourhoods, static_argnames=("k", "min_count", "slots", "doublings"))
voxel_means = jax.jit(clouds.voxel_means, static_argnames="capacity")
neighbouring_runs = jax.jit(clouds.neighbouring_runs)


def surface_points(rng, n: int) -> np.ndarray:
    """Points of a bumpy sheet a metre or two in size, with noise, float32."""
    xy = rng.uniform(-1, 1, size=(n, 2))
    z = 0.3 * np.sin(3 * xy[:, 0]) * np.cos(2 * xy[:, 1]) + rng.normal(scale=0.002, size=n)
    return np.column_stack([xy, z]).astype(np.float32)


def test_voxel_means_are_those_of_a_dictionary(rng):
    points = surface_points(rng, 2000)
    points[5] = np.nan
    valid = rng.random(2000) < 0.9
    valid[5] = False
    values = rng.normal(size=(2000, 2)).astype(np.float32)
    means = voxel_means(
        jnp.asarray(points), jnp.asarray(values), jnp.asarray(valid), jnp.asarray(0.1), capacity=1024
    )
    cells: dict[tuple[int, ...], list[int]] = {}
    for i in np.flatnonzero(valid):
        cells.setdefault(tuple(np.floor(points[i] / np.float32(0.1)).astype(int)), []).append(int(i))
    assert int(means.valid.sum()) == len(cells)
    assert means.dropped == 0
    assert occupied_cells(jnp.asarray(points), jnp.asarray(valid), jnp.asarray(0.1)) == len(cells)
    used = np.asarray(means.valid)
    for point, value in zip(np.asarray(means.points)[used], np.asarray(means.values)[used], strict=True):
        members = cells[tuple(np.floor(point / np.float32(0.1)).astype(int))]
        np.testing.assert_allclose(point, points[members].mean(axis=0), atol=1e-6)
        np.testing.assert_allclose(value, values[members].mean(axis=0), atol=1e-6)


def test_points_beyond_the_capacity_or_the_range_are_counted(rng):
    points, valid = jnp.asarray(surface_points(rng, 500)), jnp.ones(500, bool)
    values = jnp.zeros((500, 0))
    full = voxel_means(points, values, valid, jnp.asarray(0.1), capacity=500)
    cut = voxel_means(points, values, valid, jnp.asarray(0.1), capacity=100)
    assert cut.valid.sum() == 100
    np.testing.assert_array_equal(cut.points, full.points[:100])
    assert 0 < cut.dropped < 500
    far = points.at[3].set(jnp.asarray([1e9, 0, 0]))
    assert voxel_means(far, values, valid, jnp.asarray(0.1), capacity=500).dropped == 1


@pytest.mark.parametrize("bits", range(12, 21))
def test_no_point_around_a_query_is_met_twice(rng, bits):
    """In tables of every size, with points in all 27 cells around each query."""
    count = (1 << bits) // 8
    cells = rng.integers(-1000, 1000, size=(min(count // 27, 300), 1, 3))
    around = np.stack(np.meshgrid(*[[-1, 0, 1]] * 3), -1).reshape(27, 3)
    crowd = (cells + around).reshape(-1, 3)
    others = rng.integers(-1000, 1000, size=(count - len(crowd), 3))
    points = jax.device_put((np.concatenate([crowd, others]) + 0.5).astype(np.float32))
    grid = build_hash(points, jax.device_put(np.ones(count, bool)), jnp.asarray(1.0))
    assert len(grid.starts) == (1 << bits) + 1
    runs = neighbouring_runs(grid, jax.device_put((cells[:, 0].T + 0.5).astype(np.float32)))
    number = np.asarray(runs.ends[-1])
    places = np.asarray(jax.jit(type(runs).places)(runs, np.arange(number.max(), dtype=np.int32)[:, None]))
    for query, candidates in enumerate(number):
        met = np.asarray(grid.order)[places[:candidates, query]]
        assert len(set(met)) == candidates
        assert set(range(27 * query, 27 * query + 27)) <= set(met)


@pytest.mark.parametrize("count", [3000, 40_000])
def test_the_nearest_point_is_that_of_a_tree(rng, count):
    points = surface_points(rng, count)
    queries = points[:2000] + rng.normal(scale=0.02, size=(2000, 3)).astype(np.float32)
    valid = rng.random(count) < 0.7
    grid = build_hash(jnp.asarray(points), jnp.asarray(valid), jnp.asarray(0.05))
    index, found = nearest(grid, jnp.asarray(queries.T), slots=250)
    assert int(neighbouring_runs(grid, jnp.asarray(queries.T)).ends[-1].max()) <= 250
    distance, _ = KDTree(points[valid]).query(queries)
    inside = distance < 0.05
    assert inside.mean() > 0.5
    assert np.all(np.asarray(found)[inside])
    assert np.all(valid[np.asarray(index)[inside]])
    reached = np.linalg.norm(points[np.asarray(index)] - queries, axis=1)
    np.testing.assert_allclose(reached[inside], distance[inside], rtol=1e-4, atol=1e-6)


def test_an_empty_hash_has_no_nearest_point(rng):
    points = jnp.asarray(surface_points(rng, 100))
    grid = build_hash(points, jnp.zeros(100, bool), jnp.asarray(0.05))
    _, found = nearest(grid, points.T, slots=16)
    assert not np.any(found)
    with pytest.raises(InputError, match="at most 256 slots"):
        nearest(grid, points.T, slots=257)


def test_covariances_are_those_of_the_k_nearest(rng):
    points = surface_points(rng, 4000)
    valid = rng.random(4000) < 0.8
    found = neighbourhoods(
        jnp.asarray(points), jnp.asarray(valid), jnp.asarray(0.15), k=20, min_count=6, slots=250, doublings=0
    )
    kept = points[valid].astype(np.float64)
    distance, index = KDTree(kept).query(kept, k=20)
    exact = distance[:, -1] < 0.15
    assert exact.mean() > 0.8
    assert found.dropped == 0
    counts = np.asarray(found.counts)[valid][exact]
    assert counts.min() >= 20
    assert counts.mean() < 20.2  # those at equal distances
    expected = np.stack([np.cov(kept[i].T, bias=True) for i in np.asarray(index)[exact]])
    alike = counts == 20
    got = np.asarray(found.covariances)[valid][exact][alike]
    for entry, (i, j) in enumerate(INDICES):
        np.testing.assert_allclose(got[:, entry], expected[alike, i, j], atol=1e-6)
    assert not np.any(np.asarray(found.counts)[~valid])


def test_sparse_points_are_looked_for_farther_away(rng):
    points = jnp.asarray(surface_points(rng, 300))
    arguments = points, jnp.ones(300, bool), jnp.asarray(0.1)
    near = neighbourhoods(*arguments, k=20, min_count=6, slots=96, doublings=0)
    wide = neighbourhoods(*arguments, k=20, min_count=6, slots=96, doublings=2)
    assert np.median(near.counts) < 20
    assert np.mean(np.asarray(wide.counts) >= 20) > 0.95
    assert wide.dropped == 0


def test_a_crowd_farther_away_spoils_no_neighbourhood(rng):
    """The end of a sparse line before a crowd keeps the few neighbours it has, if they are enough."""
    line = np.column_stack([np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)])
    crowd = rng.uniform(0, 0.1, size=(1500, 3))
    crowd[:, 0] += 1.4
    points = jnp.asarray(np.concatenate([line, crowd]), jnp.float32)
    arguments = points, jnp.ones(len(points), bool), jnp.asarray(0.3)
    near = neighbourhoods(*arguments, k=12, min_count=4, slots=64, doublings=0)
    found = neighbourhoods(*arguments, k=12, min_count=4, slots=64, doublings=1)
    end = slice(7, 10)  # the crowd is in the next of the doubled cells
    assert np.all(np.asarray(near.counts[end]) < 12)
    np.testing.assert_array_equal(found.counts[end], near.counts[end])
    np.testing.assert_allclose(found.covariances[end], near.covariances[end])
    assert found.dropped == near.dropped  # the crowd's own
    assert neighbourhoods(*arguments, k=12, min_count=12, slots=64, doublings=1).dropped > found.dropped


def test_full_slots_are_reported(rng):
    points = jnp.asarray(surface_points(rng, 2000))
    found = neighbourhoods(
        points, jnp.ones(2000, bool), jnp.asarray(0.5), k=20, min_count=6, slots=32, doublings=0
    )
    assert found.dropped > 1000
    assert all(bool(np.all(np.isfinite(leaf))) for leaf in jax.tree.leaves(found))
