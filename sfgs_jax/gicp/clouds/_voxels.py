"""Voxel-grid downsampling: one mean point for each occupied cell."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import digit_bits, stable_order


class VoxelMeans(eqx.Module):
    """Means over the occupied cells of a grid, in a list of fixed capacity.

    Attributes:
        points: (M, 3) mean position of each cell's points, metres; 0 where not valid.
        values: (M, C) mean of the values that belong to the points.
        valid: (M,) whether the entry is a cell.
        size: edge of a cell, metres.
        dropped: number of points left out, beyond the grid's range or in a cell beyond the capacity.
    """

    points: Float[Array, "M 3"]
    values: Float[Array, "M C"]
    valid: Bool[Array, " M"]
    size: Float[Array, ""]
    dropped: Int[Array, ""]


def cells_of(points: Float[Array, "N 3"], size: Float[Array, ""]) -> Int[Array, "N 3"]:
    """Integer coordinates of the cells that points lie in, clipped to 2^20 each way."""
    limit = 1 << 20
    return jnp.clip(jnp.floor(lax.stop_gradient(points) / size), -limit, limit).astype(jnp.int32)


def voxel_means(
    points: Float[Array, "N 3"],
    values: Float[Array, "N C"],
    valid: Bool[Array, " N"],
    size: Float[Array, ""],
    *,
    capacity: int,
) -> VoxelMeans:
    """Mean of the points of each occupied cell, and of the values that go with them.

    The grid reaches 2^19 cells from the origin each way, or 2^(digit_bits(N) - 1) if that is less. So points
    should lie around the origin.

    Args:
        points: metres, at least one.
        values: any rows that belong to the points.
        valid: mask of the points.
        size: edge of a cell, metres.
        capacity: cells kept at most; static.
    """
    count = points.shape[0]
    half = 1 << (min(digit_bits(count), 20) - 1)
    cells = cells_of(points, size)
    inside = valid & jnp.all((cells >= -half) & (cells < half - 1), axis=1)
    # Points that don't count get the last cell of the range, so that they come last.
    digits = jnp.where(inside[:, None], cells + half, 2 * half - 1).astype(jnp.uint32)
    order = stable_order(*digits.T)
    ordered, counts = digits[order], inside[order]
    first = jnp.any(ordered != jnp.roll(ordered, 1, axis=0), axis=1).at[0].set(True) & counts
    entry = jnp.where(counts, jnp.cumsum(first, dtype=jnp.int32) - 1, capacity)

    # Offsets within the cell are small, so their sums lose nothing.
    corner = cells.astype(points.dtype) * size
    offsets = jnp.where(inside[:, None], points - corner, 0)
    held = jnp.where(inside[:, None], values, 0)
    rows = jnp.concatenate([offsets, held, inside.astype(points.dtype)[:, None]], axis=1)[order]
    sums = jax.ops.segment_sum(rows, entry, capacity, indices_are_sorted=True)
    start = jnp.searchsorted(entry, jnp.arange(capacity, dtype=jnp.int32))
    occupied = sums[:, -1] > 0
    mean = sums[:, :-1] / jnp.maximum(sums[:, -1:], 1)
    base = corner[order[jnp.minimum(start, count - 1)]]
    means = jnp.where(occupied[:, None], base + mean[:, :3], 0)
    dropped = jnp.sum(valid, dtype=jnp.int32) - jnp.sum(sums[:, -1]).astype(jnp.int32)
    return VoxelMeans(means, mean[:, 3:], occupied, size, dropped)


def occupied_cells(
    points: Float[Array, "N 3"], valid: Bool[Array, " N"], size: Float[Array, ""]
) -> Int[Array, ""]:
    """Number of cells that hold a point; cells that share a 32-bit hash count once."""
    keys, nothing = jnp.zeros(points.shape[0], jnp.uint32), jnp.uint32(0xFFFFFFFF)
    for cell in cells_of(points, size).astype(jnp.uint32).T:
        keys = (keys + cell) * jnp.uint32(0x9E3779B1)
        keys = (keys ^ (keys >> 15)) * jnp.uint32(0x85EBCA77)
        keys = keys ^ (keys >> 13)
    keys = jnp.sort(jnp.where(valid, keys, nothing))
    new = (keys != nothing) & (keys != jnp.roll(keys, 1)).at[:1].set(True)
    return jnp.sum(new, dtype=jnp.int32)
