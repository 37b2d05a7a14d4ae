"""Which Gaussians each tile of the image needs, in the order of their depth.

A Gaussian reaches as far as its contribution is at least 1/255: an ellipse. Its tiles are found exactly,
in two expansions: into the rows of tiles it crosses, then in each row into the tiles between its leftmost
and rightmost point there. The (tile, Gaussian) pairs are sorted by tile and depth.
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Int

from sfgs_jax.splatting.projection import MIN_ALPHA, Projected
from sfgs_jax.splatting.sorting import sort_by_tile_and_depth

_SLACK = 1e-4
"""Added to the ellipse's squared radius (of 0 to 11), so that rounding drops no tile that is needed."""


class TileLists(eqx.Module):
    """Lists of Gaussians per tile, nearest first; tiles row by row.

    Attributes:
        gaussians: (P,) indices of the Gaussians in the lists of all tiles, one list after the other.
        starts: (T,) where in `gaussians` each tile's list begins.
        counts: (T,) how long it is.
        overflow: pairs that found no room; those of the last Gaussians.
    """

    gaussians: Int[Array, " p"]
    starts: Int[Array, " t"]
    counts: Int[Array, " t"]
    overflow: Int[Array, ""]


def tile_grid(width: int, height: int, tile_size: int) -> tuple[int, int]:
    """Columns and rows of tiles that cover an image."""
    return -(-width // tile_size), -(-height // tile_size)


def bin_into_tiles(
    projected: Projected,
    *,
    width: int,
    height: int,
    tile_size: int,
    pair_capacity: int,
) -> TileLists:
    """Lists of the Gaussians that reach each tile."""
    columns, rows = tile_grid(width, height, tile_size)
    tiles = columns * rows
    spans, row_overflow = _row_spans(projected, columns, rows, tile_size, pair_capacity)

    entry, offset, pair_overflow = _expand(spans.counts, pair_capacity)
    tile = spans.first_tiles[entry] + offset
    tile = jnp.where(offset >= 0, tile, tiles)
    gaussian = spans.gaussians[entry]
    counts = jnp.zeros(tiles, jnp.int32).at[tile].add(1, mode="drop")
    return TileLists(
        gaussians=sort_by_tile_and_depth(
            tile,
            projected.depths[gaussian],
            gaussian,
            tile_count=tiles,
            gaussian_count=projected.visible.shape[0],
        ),
        starts=jnp.cumsum(counts) - counts,
        counts=counts,
        overflow=row_overflow + pair_overflow,
    )


def count_rows(projected: Projected, *, height: int, tile_size: int) -> Int[Array, ""]:
    """Number of (row of tiles, Gaussian) pairs."""
    ellipses = _Ellipses.of(projected)
    return jnp.sum(ellipses.tile_rows(tile_grid(1, height, tile_size)[1], tile_size)[1])


def count_pairs(
    projected: Projected, *, width: int, height: int, tile_size: int, row_capacity: int
) -> Int[Array, ""]:
    """Number of (tile, Gaussian) pairs; `row_capacity` must not be below `count_rows`."""
    columns, rows = tile_grid(width, height, tile_size)
    return jnp.sum(_row_spans(projected, columns, rows, tile_size, row_capacity)[0].counts)


class _RowSpans(eqx.Module):
    """Stretches of adjacent tiles in one row that one Gaussian reaches."""

    gaussians: Array
    first_tiles: Array
    counts: Array


def _row_spans(
    projected: Projected, columns: int, rows: int, tile_size: int, capacity: int
) -> tuple[_RowSpans, Array]:
    """The spans of all Gaussians, and how many found no room."""
    ellipses = _Ellipses.of(projected)
    first_row, row_counts = ellipses.tile_rows(rows, tile_size)
    owner, offset, overflow = _expand(row_counts, capacity)
    row = first_row[owner] + offset
    first_column, counts = ellipses.at(owner).tile_columns(row, columns, tile_size)
    spans = _RowSpans(
        gaussians=owner,
        first_tiles=row * columns + first_column,
        counts=jnp.where(offset >= 0, counts, 0),
    )
    return spans, overflow


class _Ellipses(eqx.Module):
    """The ellipses |U d|² <= reach inside of which Gaussians contribute."""

    u: Array
    v: Array
    p: Array
    q: Array
    r: Array
    reach: Array  # negative where nothing is drawn

    @staticmethod
    def of(projected: Projected) -> "_Ellipses":
        reach = 2 * (projected.log_opacities - math.log(MIN_ALPHA)) + _SLACK
        reach = jnp.where(projected.visible, reach, -1)
        columns = [*projected.centres.T, *projected.whitening.T, reach]
        return _Ellipses(*columns)

    def at(self, index: Array) -> "_Ellipses":
        table = jnp.stack([self.u, self.v, self.p, self.q, self.r, self.reach], axis=1)[index]
        return _Ellipses(*(table[:, i] for i in range(6)))

    def tile_rows(self, rows: int, tile_size: int) -> tuple[Array, Array]:
        """First row of tiles and number of rows that the ellipse may reach."""
        drawn = self.reach >= 0
        extent = jnp.sqrt(jnp.maximum(self.reach, 0)) / jnp.where(drawn, self.r, 1)
        first, last = _tile_range(self.v - extent, self.v + extent, rows, tile_size)
        return first, jnp.where(drawn, jnp.maximum(last - first + 1, 0), 0)

    def tile_columns(self, row: Array, columns: int, tile_size: int) -> tuple[Array, Array]:
        """First column of tiles and number of columns that the ellipse reaches in a row of tiles."""
        top = (row * tile_size).astype(self.v.dtype) - self.v
        bottom = top + (tile_size - 1)
        radius = jnp.sqrt(jnp.maximum(self.reach, 0))
        # The rightmost point lies where q dv + r² dv / sqrt(reach - r² dv²) changes sign; within the
        # band of a row it lies as near to that as the band allows. The leftmost is its mirror image.
        rightmost = -self.q / self.r * radius / jnp.sqrt(self.q**2 + self.r**2)
        left = self._edge(jnp.clip(-rightmost, top, bottom), -1)
        right = self._edge(jnp.clip(rightmost, top, bottom), 1)
        first, last = _tile_range(self.u + left, self.u + right, columns, tile_size)
        # The nearest line of the band decides whether the ellipse reaches it at all.
        nearest = self.r * jnp.clip(0, top, bottom)
        reached = nearest**2 <= self.reach
        return first, jnp.where(reached, jnp.maximum(last - first + 1, 0), 0)

    def _edge(self, dv: Array, side: int) -> Array:
        """Horizontal distance from the centre to the ellipse on the line at `dv`."""
        half = jnp.sqrt(jnp.maximum(self.reach - (self.r * dv) ** 2, 0))
        return (side * half - self.q * dv) / self.p


def _tile_range(low: Array, high: Array, tiles: int, tile_size: int) -> tuple[Array, Array]:
    """First and last tile with a pixel centre in [low, high]; the last is before the first if none has."""
    # Clipped while still floating: far outside the image the integers would not hold them.
    first = jnp.clip(jnp.floor(jnp.ceil(low) / tile_size), 0, tiles)
    last = jnp.clip(jnp.floor(jnp.floor(high) / tile_size), -1, tiles - 1)
    return first.astype(jnp.int32), last.astype(jnp.int32)


def _expand(counts: Int[Array, " n"], capacity: int) -> tuple[Array, Array, Array]:
    """Give each of n owners `counts` consecutive slots, up to `capacity` in all.

    Returns:
        owner (capacity,) of each slot; its offset (capacity,) among the owner's, -1 where the slot is
        free; and the number of slots that were missing.
    """
    ends = jnp.cumsum(counts)
    starts = ends - counts
    # Every owner marks its start; the number of marks up to a slot says who owns it.
    marks = jnp.zeros(capacity, jnp.int32).at[starts].add(1, mode="drop")
    owner = _prefix_sums(marks) - 1
    slot = jnp.arange(capacity, dtype=jnp.int32)
    offset = jnp.where(slot < ends[-1], slot - starts[owner], -1)
    return owner, offset, jnp.maximum(ends[-1] - capacity, 0)


def _prefix_sums(marks: Int[Array, " n"]) -> Int[Array, " n"]:
    """Inclusive sums; several times faster than `jnp.cumsum` on a long array, exact below 2**24."""
    width = 128
    n = marks.shape[0]
    blocks = jnp.pad(marks, (0, -n % width)).reshape(-1, width).astype(jnp.float32)
    within = (blocks @ jnp.triu(jnp.ones((width, width), jnp.float32))).astype(jnp.int32)
    before = jnp.cumsum(within[:, -1]) - within[:, -1]
    return (within + before[:, None]).reshape(-1)[:n]
