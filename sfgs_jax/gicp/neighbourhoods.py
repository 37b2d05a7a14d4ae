"""Covariances of the k nearest neighbours of every point, found in a spatial hash."""

from itertools import combinations_with_replacement

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.gicp.spatial_hash import MAX_SLOTS, SpatialHash, build_hash, neighbouring_runs, square_distances

_BLOCK = 1024
_BISECTIONS = 14


class Neighbourhoods(eqx.Module):
    """Second moments of the points around each point.

    Attributes:
        covariances: (M, 6) upper triangles xx xy xz yy yz zz, square metres.
        counts: (M,) points they come from, the point itself among them.
        missed: candidates that did not fit the slots, over all points.
    """

    covariances: Float[Array, "M 6"]
    counts: Int[Array, " M"]
    missed: Int[Array, ""]


def neighbourhoods(
    points: Float[Array, "M 3"],
    valid: Bool[Array, " M"],
    size: Float[Array, ""],
    *,
    k: int,
    slots: int,
    doublings: int,
) -> Neighbourhoods:
    """Covariance of the k nearest neighbours of each point (itself included), or of as many as there are.

    Neighbours are looked for in the 27 cells of `size` metres around a point; where they hold fewer than k,
    in cells of twice the size, and so on. They are the k nearest for sure if the farthest is no farther
    than the cells' size. Squared distances count as equal if they
    differ by less than a thousandth of the cells' size squared.

    Args:
        points: metres.
        valid: which points there are.
        size: edge of the first cells.
        k: neighbours; static.
        slots: most candidates for one point, twice as many in doubled cells; static.
        doublings: how often cells are doubled; static.
    """
    count = points.shape[0]
    padding = -count % _BLOCK
    queries = jnp.pad(points, ((0, padding), (0, 0))).reshape(-1, _BLOCK, 3).swapaxes(1, 2)
    wanted = jnp.pad(valid, (0, padding)).reshape(-1, _BLOCK)
    grids = [build_hash(points, valid, size * 2**doubling) for doubling in range(doublings + 1)]

    def block(inputs: tuple[Array, Array]) -> _Found:
        block_queries, block_wanted = inputs
        dtype = points.dtype
        found = _Found(jnp.zeros((6, _BLOCK), dtype), jnp.zeros(_BLOCK, dtype), jnp.zeros(_BLOCK, jnp.int32))
        for doubling, grid in enumerate(grids):
            room = slots if doubling == 0 else min(2 * slots, MAX_SLOTS)
            # Empty blocks cost nothing, nor do wider cells where the first ones held enough.
            short = block_wanted & (found.counts < k)
            found = lax.cond(
                jnp.any(short),
                lambda f, short=short, grid=grid, room=room: _choose(
                    short, _around(grid, block_queries, k, room), f
                ),
                lambda f: f,
                found,
            )
        return found

    found = lax.map(block, (queries, wanted))
    counts = jnp.where(valid, found.counts.reshape(-1)[:count], 0).astype(jnp.int32)
    covariances = found.covariances.swapaxes(1, 2).reshape(-1, 6)[:count]
    return Neighbourhoods(
        jnp.where(valid[:, None], covariances, 0),
        counts,
        jnp.sum(jnp.where(wanted, found.missed, 0), dtype=jnp.int32),
    )


class _Found(eqx.Module):
    """What one block of points found: covariances, counts, and candidates beyond the slots."""

    covariances: Float[Array, "6 Q"]
    counts: Float[Array, " Q"]
    missed: Int[Array, " Q"]


def _choose(first: Bool[Array, " Q"], a: _Found, b: _Found) -> _Found:
    return jax.tree.map(lambda x, y: jnp.where(first, x, y), a, b)


def _around(grid: SpatialHash, queries: Float[Array, "3 Q"], k: int, slots: int) -> _Found:
    runs = neighbouring_runs(grid, queries)
    slot = jnp.arange(slots, dtype=jnp.int32)[:, None]
    inside = slot < runs.ends[-1]
    place = jnp.where(inside, runs.places(slot), 0)
    square = jnp.where(inside, square_distances(grid, lax.stop_gradient(queries), place), jnp.inf)
    near = (square <= _kth_smallest(square, k, 3 * (2 * grid.size) ** 2)).astype(queries.dtype)

    count = jnp.sum(near, axis=0)
    scale = 1 / jnp.maximum(count, 1)
    x, y, z = (
        near * (c.at[place].get(mode="promise_in_bounds") - q)
        for c, q in zip(grid.points, queries, strict=True)
    )
    means = [jnp.sum(c, axis=0) * scale for c in (x, y, z)]
    covariances = [
        jnp.sum(a * b, axis=0) * scale - means[i] * means[j]
        for (i, a), (j, b) in combinations_with_replacement(enumerate((x, y, z)), 2)
    ]
    return _Found(jnp.stack(covariances), count, jnp.maximum(runs.ends[-1] - slots, 0))


def _kth_smallest(values: Float[Array, "S Q"], k: int, largest: Float[Array, ""]) -> Float[Array, " Q"]:
    """Per column hardly above the least bound that k of the values don't exceed; else `largest`."""
    low, high = jnp.zeros_like(values[0]), jnp.full_like(values[0], 1) * largest

    def halve(_: Array, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) / 2
        enough = jnp.sum((values <= middle).astype(values.dtype), axis=0) >= k
        return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

    return lax.fori_loop(0, _BISECTIONS, halve, (low, high))[1]
