"""Spatial hash: neighbours in a list of points, by grid cells with fixed capacities.

Points are sorted by the bucket of their cell, and a table holds the start of each bucket. Buckets along x
follow each other, so three neighbouring cells of a row are one run of the sorted list. The 27 cells around a
point are nine runs. Cells that share a bucket only add candidates, which their distances rule out.

Source: Teschner et al., Optimized spatial hashing for collision detection of deformable objects (VMV 2003).
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import InputError, digit_bits, packed_argmin, stable_order
from sfgs_jax.gicp.clouds._voxels import cells_of

# With these steps the nine rows around a cell begin more than three buckets apart, in any table of at least
# 2^_MIN_BITS buckets. So no point is met twice.
_STEP_Y, _STEP_Z = 0x9E3779B1, 0x85EBCA77
_MIN_BITS = 12
_ROWS = np.asarray([(y, z) for z in (-1, 0, 1) for y in (-1, 0, 1)], np.int32)
_SLOT_BITS = 8
"""Bits of a distance that give way to the number of a candidate."""


class SpatialHash(eqx.Module):
    """Points sorted by the bucket of their grid cell.

    Attributes:
        size: edge of a cell, metres.
        first_x: x of the first cell that holds a point.
        starts: (B + 1,) start of each of the B buckets in `order`; B is a power of two.
        order: (M,) index of the points by bucket; points that are not valid come last.
        points: (3, M) the points in that order, metres.
    """

    size: Float[Array, ""]
    first_x: Int[Array, ""]
    starts: Int[Array, " B"]
    order: Int[Array, " M"]
    points: Float[Array, "3 M"]


class Runs(eqx.Module):
    """The nine runs of a hash's sorted list that hold the 27 cells around each query.

    Attributes:
        ends: (9, Q) number of points in the runs up to this one.
        shifts: (9, Q) place in the sorted list, less the number of the candidate.
    """

    ends: Int[Array, "9 Q"]
    shifts: Int[Array, "9 Q"]

    def places(self, slot: Int[Array, "..."]) -> Int[Array, "..."]:
        """Place in the sorted list of the slot-th candidate of each query (queries along the last axis)."""
        broadcast = (1,) * (slot.ndim - 1) + (-1,)
        place = slot + self.shifts[0].reshape(broadcast)
        for end, shift in zip(self.ends[:-1], self.shifts[1:], strict=True):
            place = jnp.where(slot >= end.reshape(broadcast), slot + shift.reshape(broadcast), place)
        return place


def build_hash(points: Float[Array, "M 3"], valid: Bool[Array, " M"], size: Float[Array, ""]) -> SpatialHash:
    """Sort points into the buckets of a grid with cells of `size` metres."""
    count = points.shape[0]
    bits = min(max((8 * count - 1).bit_length(), _MIN_BITS), 20)
    buckets = 1 << bits
    cells = cells_of(points, size)
    first_x = jnp.min(jnp.where(valid, cells[:, 0], jnp.iinfo(jnp.int32).max // 2))
    x, y, z = cells.T
    bucket = jnp.where(valid, _row(y, z, buckets) + _column(x, first_x, buckets), buckets)
    # A bucket and an index may not fit one word; then there are two passes, by the low and the high digits.
    low = min(bits + 1, digit_bits(count))
    key = bucket.astype(jnp.uint32)
    digits = [key & ((1 << low) - 1)] + ([key >> low] if low < bits + 1 else [])
    order = stable_order(*digits)
    starts = jnp.searchsorted(bucket[order], jnp.arange(buckets + 1, dtype=jnp.int32)).astype(jnp.int32)
    return SpatialHash(size, first_x, starts, order, points[order].T)


def _row(y: Int[Array, "*n"], z: Int[Array, "*n"], buckets: int) -> Int[Array, "*n"]:
    """First bucket of a row of cells along x."""
    word = y.astype(jnp.uint32) * jnp.uint32(_STEP_Y) + z.astype(jnp.uint32) * jnp.uint32(_STEP_Z)
    return (word & jnp.uint32(buckets // 2 - 1)).astype(jnp.int32)


def _column(x: Int[Array, "*n"], first_x: Int[Array, ""], buckets: int) -> Int[Array, "*n"]:
    """Buckets from the beginning of a row to the cell at x; points and queries are clipped alike."""
    return jnp.clip(x - first_x, 0, buckets // 2 - 1)


def neighbouring_runs(grid: SpatialHash, queries: Float[Array, "3 Q"]) -> Runs:
    """Runs of the points in the 27 cells around each query.

    Every point within one cell's edge of a query is among them.
    """
    buckets = grid.starts.shape[0] - 1
    x, y, z = cells_of(queries.T, grid.size).T
    row = _row(y[None] + _ROWS[:, :1], z[None] + _ROWS[:, 1:], buckets)
    begins = grid.starts[row + _column(x - 1, grid.first_x, buckets)[None]]
    lengths = grid.starts[row + _column(x + 1, grid.first_x, buckets)[None] + 1] - begins
    ends = [lengths[0]]
    for length in lengths[1:]:
        ends.append(ends[-1] + length)
    stacked = jnp.stack(ends)
    return Runs(stacked, begins - (stacked - lengths))


def nearest(
    grid: SpatialHash, queries: Float[Array, "3 Q"], *, slots: int
) -> tuple[Int[Array, " Q"], Bool[Array, " Q"]]:
    """Index of the point nearest to each query, and whether any is in the 27 cells around it.

    The nearest one is found for sure within one cell's edge if `slots` holds all candidates.

    Args:
        grid: hash of the points.
        queries: positions, metres.
        slots: most candidates for one query, at most 256; static.

    Raises:
        InputError: there are too many slots.
    """
    if slots > 1 << _SLOT_BITS:
        raise InputError(f"The nearest point is looked for in at most {1 << _SLOT_BITS} slots, not {slots}.")
    runs = neighbouring_runs(grid, queries)
    slot = jnp.arange(slots, dtype=jnp.int32)[:, None]
    inside = slot < runs.ends[-1:]
    place = jnp.where(inside, runs.places(slot), 0)
    square = square_distances(grid, queries, place)
    best = packed_argmin(square, inside, index_bits=_SLOT_BITS)
    found = runs.ends[-1] > 0
    return grid.order[jnp.where(found, runs.places(best), 0)], found


def square_distances(
    grid: SpatialHash, queries: Float[Array, "3 Q"], place: Int[Array, "S Q"]
) -> Float[Array, "S Q"]:
    """Squared distances from each query to the points at some places of the sorted list."""
    x, y, z = (
        c.at[place].get(mode="promise_in_bounds") - q[None] for c, q in zip(grid.points, queries, strict=True)
    )
    return x * x + y * y + z * z
