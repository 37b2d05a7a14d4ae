"""Covariances of the k nearest neighbours of every point, found in a spatial hash."""

from itertools import combinations_with_replacement

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import stable_order
from sfgs_jax.gicp.clouds._spatial_hash import SpatialHash, build_hash, neighbouring_runs, square_distances

_BLOCK = 1024
"""Points that are searched for at once."""

_WIDER_SLOTS = 4
"""Factor of the slots in a widened search: few points need one, and they may border on crowded cells."""

_BISECTIONS = 14
"""Bisections of the k-th smallest distance: it is exact to 2^-14 of its range."""


class Neighbourhoods(eqx.Module):
    """Second moments of the points around each point.

    Attributes:
        covariances: (M, 6) upper triangles xx xy xz yy yz zz, square metres.
        counts: (M,) number of points in each, the point itself among them.
        dropped: number of candidates without a slot, over all points whose covariance they could change.
    """

    covariances: Float[Array, "M 6"]
    counts: Int[Array, " M"]
    dropped: Int[Array, ""]


def neighbourhoods(
    points: Float[Array, "M 3"],
    valid: Bool[Array, " M"],
    size: Float[Array, ""],
    *,
    k: int,
    min_count: int,
    slots: int,
    doublings: int,
) -> Neighbourhoods:
    """Covariance of the k nearest neighbours of each point, itself included, or of all if there are fewer.

    Neighbours are looked for in the 27 cells of `size` metres around a point. If these hold fewer than k, the
    search goes on in cells of twice the size, and so on. The k nearest are found for sure if the farthest is
    within the cells' size. Squared distances count as equal if they differ by less than a thousandth of the
    cells' size squared.

    Args:
        points: metres.
        valid: mask of the points.
        size: edge of the first cells, metres.
        k: number of neighbours; static.
        min_count: neighbours that suffice if crowded cells begin before the k-th; static.
        slots: most candidates for one point, four times more in wider cells; static.
        doublings: number of times that cells are doubled; static.
    """
    found = _search(build_hash(points, valid, size), points, valid, k=k, slots=slots, block=_BLOCK)

    def widen(found: _Found, factor: Array) -> tuple[_Found, None]:
        short = valid & (found.counts < k)
        # Short points come first: they fill few blocks, and the others cost nothing.
        order = stable_order((~short).astype(jnp.uint32))
        rank = jnp.zeros_like(order).at[order].set(jnp.arange(len(order), dtype=order.dtype))
        wider = _search(
            build_hash(points, valid, size * factor),
            points[order],
            short[order],
            k=k,
            slots=_WIDER_SLOTS * slots,
            block=_BLOCK // _WIDER_SLOTS,
        )
        wider = jax.tree.map(lambda values: values[rank], wider)
        # With more candidates than slots the few neighbours found nearer by are better than wrong ones.
        better = short & (wider.dropped == 0)
        return _Found(
            jnp.where(better[:, None], wider.covariances, found.covariances),
            jnp.where(better, wider.counts, found.counts),
            jnp.where(short, wider.dropped, found.dropped),
        ), None

    if doublings:
        found, _ = lax.scan(widen, found, 2.0 ** jnp.arange(1, doublings + 1, dtype=size.dtype))
    sufficient = (found.counts >= min_count) & (found.counts < k)
    dropped = jnp.sum(jnp.where(sufficient, 0, found.dropped), dtype=jnp.int32)
    return Neighbourhoods(found.covariances, found.counts.astype(jnp.int32), dropped)


class _Found(eqx.Module):
    """Covariance, count, and number of candidates beyond the slots of each point; 0 for inactive queries."""

    covariances: Float[Array, "M 6"]
    counts: Float[Array, " M"]
    dropped: Int[Array, " M"]


def _search(
    grid: SpatialHash,
    queries: Float[Array, "M 3"],
    active: Bool[Array, " M"],
    *,
    k: int,
    slots: int,
    block: int,
) -> _Found:
    """Search around the active queries, a block at a time; a block without any is skipped."""
    count = queries.shape[0]
    padding = -count % block
    blocks = jnp.pad(queries, ((0, padding), (0, 0))).reshape(-1, block, 3).swapaxes(1, 2)
    active_blocks = jnp.pad(active, (0, padding)).reshape(-1, block)

    def search(inputs: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        dtype = queries.dtype
        empty = jnp.zeros((6, block), dtype), jnp.zeros(block, dtype), jnp.zeros(block, jnp.int32)
        return lax.cond(jnp.any(inputs[1]), lambda: _around(grid, inputs[0], k, slots), lambda: empty)

    covariances, counts, dropped = lax.map(search, (blocks, active_blocks))
    return _Found(
        jnp.where(active[:, None], covariances.swapaxes(1, 2).reshape(-1, 6)[:count], 0),
        jnp.where(active, counts.reshape(-1)[:count], 0),
        jnp.where(active, dropped.reshape(-1)[:count], 0),
    )


def _around(
    grid: SpatialHash, queries: Float[Array, "3 Q"], k: int, slots: int
) -> tuple[Float[Array, "6 Q"], Float[Array, " Q"], Int[Array, " Q"]]:
    """Covariances, counts, and numbers of candidates without a slot."""
    runs = neighbouring_runs(grid, queries)
    slot = jnp.arange(slots, dtype=jnp.int32)[:, None]
    inside = slot < runs.ends[-1:]
    place = jnp.where(inside, runs.places(slot), 0)
    square = jnp.where(inside, square_distances(grid, lax.stop_gradient(queries), place), jnp.inf)
    limit = _kth_smallest(square, k, 3 * (2 * grid.size) ** 2)[None]
    near = (square <= limit).astype(queries.dtype)

    count = jnp.sum(near, axis=0)
    scale = 1 / jnp.maximum(count, 1)
    x, y, z = (
        near * (c.at[place].get(mode="promise_in_bounds") - q[None])
        for c, q in zip(grid.points, queries, strict=True)
    )
    means = [jnp.sum(c, axis=0) * scale for c in (x, y, z)]
    covariances = [
        jnp.sum(a * b, axis=0) * scale - means[i] * means[j]
        for (i, a), (j, b) in combinations_with_replacement(enumerate((x, y, z)), 2)
    ]
    return jnp.stack(covariances), count, jnp.maximum(runs.ends[-1] - slots, 0)


def _kth_smallest(values: Float[Array, "S Q"], k: int, largest: Float[Array, ""]) -> Float[Array, " Q"]:
    """k-th smallest value of each column, by bisection from above; `largest` if there are fewer."""
    low, high = jnp.zeros_like(values[0]), jnp.full_like(values[0], 1) * largest

    def halve(_: Array, bounds: tuple[Array, Array]) -> tuple[Array, Array]:
        low, high = bounds
        middle = (low + high) / 2
        enough = jnp.sum((values <= middle[None]).astype(values.dtype), axis=0) >= k
        return jnp.where(enough, low, middle), jnp.where(enough, middle, high)

    return lax.fori_loop(0, _BISECTIONS, halve, (low, high))[1]
