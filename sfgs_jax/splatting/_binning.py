"""Tile binning: the list of Gaussians that each tile of the image needs, nearest first.

A Gaussian ends where its contribution falls below 1/255: an ellipse. Its tiles are found exactly, in two
expansions. The first is into the rows of tiles that it crosses. The second is, in each row, into the tiles
between its leftmost and rightmost point there. The (tile, Gaussian) pairs are sorted by tile and depth.
"""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked, prefix_sums
from sfgs_jax.splatting._projection import Projected
from sfgs_jax.splatting._sorting import sort_by_tile_and_depth
from sfgs_jax.splatting._thresholds import MIN_ALPHA

_SLACK = 1e-4
"""Added to the ellipse's squared radius (of 0 to 11), so that rounding drops no tile that is needed."""


class TileLists(eqx.Module):
    """Lists of Gaussians per tile, nearest first; tiles row by row.

    Attributes:
        gaussians: (P,) indices of the Gaussians in the lists of all tiles, one list after the other.
        starts: (T,) position in `gaussians` at which each tile's list begins.
        counts: (T,) length of each tile's list.
        overflow: number of pairs that found no room. They belong to the Gaussians of the highest index.
        needed: room for pairs that the image needs, at least so much where some found none.
    """

    gaussians: Int[Array, " p"]
    starts: Int[Array, " t"]
    counts: Int[Array, " t"]
    overflow: Int[Array, ""]
    needed: Int[Array, ""]


class Occluder(eqx.Module):
    """A surface that hides Gaussians from the camera.

    Attributes:
        nearest: (N,) least depth along z of each Gaussian, metres.
        beyond: (H, W) depth along z of the surface, metres; 0 where it is unknown.
    """

    nearest: Float[Array, " n"]
    beyond: Float[Array, "H W"]

    def farthest(self, columns: int, rows: int, tile_size: int) -> Float[Array, "{rows} {columns}"]:
        """The surface's largest depth in each tile; infinite where it is unknown all over."""
        height, width = self.beyond.shape
        room = (0, rows * tile_size - height), (0, columns * tile_size - width)
        tiles = jnp.pad(self.beyond, room).reshape(rows, tile_size, columns, tile_size)
        largest = jnp.max(tiles, axis=(1, 3))
        return jnp.where(largest > 0, largest, jnp.inf)


def tile_grid(width: int, height: int, tile_size: int) -> tuple[int, int]:
    """Columns and rows of tiles that cover an image."""
    return -(-width // tile_size), -(-height // tile_size)


@checked
def bin_into_tiles(
    projected: Projected,
    occluder: Occluder | None = None,
    *,
    width: int,
    height: int,
    tile_size: int,
    pair_capacity: int,
) -> TileLists:
    """Lists of the Gaussians that reach each tile.

    Args:
        projected: images of N Gaussians.
        occluder: what hides some of them.
        width: of the image, pixels; static.
        height: of the image, pixels; static.
        tile_size: side of a tile, pixels; static.
        pair_capacity: room for (tile, Gaussian) pairs; static.
    """
    columns, rows = tile_grid(width, height, tile_size)
    tiles = columns * rows
    ellipses = _Ellipses.of(projected)
    if occluder is not None:
        hidden = are_hidden(projected, occluder, width=width, height=height, tile_size=tile_size)
        ellipses = ellipses.without(hidden)
    spans, num_spans = _row_spans(ellipses, columns, rows, tile_size, pair_capacity)

    entry, offset, num_pairs = _expand(spans.counts, pair_capacity)
    tile = spans.first_tiles[entry] + offset
    tile = jnp.where(offset >= 0, tile, tiles)
    gaussian = spans.gaussians[entry]
    if occluder is not None:
        in_tiles = jnp.append(occluder.farthest(columns, rows, tile_size), -jnp.inf)
        tile = jnp.where(occluder.nearest[gaussian] <= in_tiles[tile], tile, tiles)
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
        overflow=jnp.maximum(num_spans - pair_capacity, 0) + jnp.maximum(num_pairs - pair_capacity, 0),
        needed=jnp.maximum(num_spans, num_pairs),
    )


def count_rows(projected: Projected, *, height: int, tile_size: int) -> Int[Array, ""]:
    """Number of (row of tiles, Gaussian) pairs."""
    _, rows = tile_grid(1, height, tile_size)
    _, counts = _Ellipses.of(projected).tile_rows(rows, tile_size)
    return jnp.sum(counts)


def count_pairs(
    projected: Projected, *, width: int, height: int, tile_size: int, row_capacity: int
) -> Int[Array, ""]:
    """Number of (tile, Gaussian) pairs; `row_capacity` must not be below `count_rows`."""
    columns, rows = tile_grid(width, height, tile_size)
    spans, _ = _row_spans(_Ellipses.of(projected), columns, rows, tile_size, row_capacity)
    return jnp.sum(spans.counts)


class _RowSpans(eqx.Module):
    """S spans, each of adjacent tiles in one row that one Gaussian reaches.

    Attributes:
        gaussians: (S,) index of the Gaussian.
        first_tiles: (S,) the leftmost tile.
        counts: (S,) number of tiles, 0 where the slot is free.
    """

    gaussians: Int[Array, " s"]
    first_tiles: Int[Array, " s"]
    counts: Int[Array, " s"]


def _row_spans(
    ellipses: "_Ellipses", columns: int, rows: int, tile_size: int, capacity: int
) -> tuple[_RowSpans, Int[Array, ""]]:
    """The spans of all Gaussians, as far as there is room, and their number."""
    first_row, row_counts = ellipses.tile_rows(rows, tile_size)
    owner, offset, number = _expand(row_counts, capacity)
    row = first_row[owner] + offset
    first_column, counts = ellipses.at(owner).tile_columns(row, columns, tile_size)
    spans = _RowSpans(
        gaussians=owner,
        first_tiles=row * columns + first_column,
        counts=jnp.where(offset >= 0, counts, 0),
    )
    return spans, number


class _Ellipses(eqx.Module):
    """The ellipses |U d|² <= reach within which N Gaussians contribute.

    Attributes:
        u: (N,) column of the centre, pixels.
        v: (N,) row of the centre, pixels.
        p: (N,) first entry of U = [[p, q], [0, r]], 1 / pixels.
        q: (N,) second entry of U.
        r: (N,) third entry of U.
        reach: (N,) squared radius in units of sigma; negative where nothing is drawn.
    """

    u: Float[Array, " n"]
    v: Float[Array, " n"]
    p: Float[Array, " n"]
    q: Float[Array, " n"]
    r: Float[Array, " n"]
    reach: Float[Array, " n"]

    @staticmethod
    def of(projected: Projected) -> "_Ellipses":
        reach = 2 * (projected.log_opacities - math.log(MIN_ALPHA)) + _SLACK
        reach = jnp.where(projected.visible, reach, -1)
        u, v = projected.centres.T
        p, q, r = projected.whitening.T
        return _Ellipses(u=u, v=v, p=p, q=q, r=r, reach=reach)

    def without(self, left_out: Bool[Array, " n"]) -> "_Ellipses":
        """The same, where some are not drawn."""
        return replace(self, reach=jnp.where(left_out, -1, self.reach))

    def at(self, index: Int[Array, " s"]) -> "_Ellipses":
        """The ellipses of some Gaussians, looked up as rows of one table."""
        table = jnp.stack([self.u, self.v, self.p, self.q, self.r, self.reach], axis=1)[index]
        u, v, p, q, r, reach = (table[:, i] for i in range(6))
        return _Ellipses(u=u, v=v, p=p, q=q, r=r, reach=reach)

    def tile_rows(self, rows: int, tile_size: int) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
        """First row of tiles and number of rows that the ellipse may reach."""
        drawn = self.reach >= 0
        extent = jnp.sqrt(jnp.maximum(self.reach, 0)) / jnp.where(drawn, self.r, 1)
        first, last = _tile_range(self.v - extent, self.v + extent, rows, tile_size)
        return first, jnp.where(drawn, jnp.maximum(last - first + 1, 0), 0)

    def tile_columns(
        self, row: Int[Array, " n"], columns: int, tile_size: int
    ) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
        """First column of tiles and number of columns that the ellipse reaches in a row of tiles."""
        top = (row * tile_size).astype(self.v.dtype) - self.v
        bottom = top + (tile_size - 1)
        radius = jnp.sqrt(jnp.maximum(self.reach, 0))
        # At the rightmost point q + r² dv / sqrt(reach - r² dv²) is zero. A row of tiles is a band, whose
        # rightmost point is the nearest to that one. The leftmost is the mirror image.
        rightmost = -self.q / self.r * radius / jnp.sqrt(self.q**2 + self.r**2)
        left = self._edge(jnp.clip(-rightmost, top, bottom), -1)
        right = self._edge(jnp.clip(rightmost, top, bottom), 1)
        first, last = _tile_range(self.u + left, self.u + right, columns, tile_size)
        # The nearest line of the band decides whether the ellipse reaches it at all.
        nearest = self.r * jnp.clip(0, top, bottom)
        reached = nearest**2 <= self.reach
        return first, jnp.where(reached, jnp.maximum(last - first + 1, 0), 0)

    def _edge(self, dv: Float[Array, " n"], side: int) -> Float[Array, " n"]:
        """Horizontal distance from the centre to the ellipse on the line at `dv`; `side` is -1 or 1."""
        half = jnp.sqrt(jnp.maximum(self.reach - (self.r * dv) ** 2, 0))
        return (side * half - self.q * dv) / self.p


def are_hidden(
    projected: Projected, occluder: Occluder, *, width: int, height: int, tile_size: int
) -> Bool[Array, " n"]:
    """Mask of the Gaussians that lie behind the surface in every tile that they reach.

    Only those no larger than a tile are looked at, which reach two by two tiles at most. Nearly all are so
    small, and those that are left out need no room for pairs.

    Args:
        projected: images of N Gaussians.
        occluder: the surface.
        width: of the image, pixels; static.
        height: of the image, pixels; static.
        tile_size: side of a tile, pixels; static.
    """
    columns, rows = tile_grid(width, height, tile_size)
    ellipses, farthest = _Ellipses.of(projected), occluder.farthest(columns, rows, tile_size)
    below = jnp.concatenate([farthest[1:], farthest[-1:]])
    both = jnp.maximum(farthest, below)
    of_four = jnp.maximum(both, jnp.concatenate([both[:, 1:], both[:, -1:]], axis=1))
    radius = jnp.sqrt(jnp.maximum(ellipses.reach, 0))
    p, r = (jnp.where(ellipses.reach >= 0, x, 1) for x in (ellipses.p, ellipses.r))
    half_height = radius / r
    half_width = radius * jnp.sqrt(ellipses.q**2 + r**2) / (p * r)
    small = (2 * half_height <= tile_size) & (2 * half_width <= tile_size)
    first_row, _ = _tile_range(ellipses.v - half_height, ellipses.v + half_height, rows, tile_size)
    first_column, _ = _tile_range(ellipses.u - half_width, ellipses.u + half_width, columns, tile_size)
    place = jnp.minimum(first_row, rows - 1) * columns + jnp.minimum(first_column, columns - 1)
    return small & (occluder.nearest > of_four.reshape(-1)[place])


def _tile_range(
    low: Float[Array, " n"], high: Float[Array, " n"], tiles: int, tile_size: int
) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """First and last tile with a pixel centre in [low, high]; the last is before the first if none has."""
    # Clipped as floats: far outside the image integers would not hold them.
    first = jnp.clip(jnp.floor(jnp.ceil(low) / tile_size), 0, tiles)
    last = jnp.clip(jnp.floor(jnp.floor(high) / tile_size), -1, tiles - 1)
    return first.astype(jnp.int32), last.astype(jnp.int32)


def _expand(
    counts: Int[Array, " n"], capacity: int
) -> tuple[Int[Array, " {capacity}"], Int[Array, " {capacity}"], Int[Array, ""]]:
    """Give each of n owners `counts` consecutive slots, up to `capacity` in all.

    Returns:
        The owner (capacity,) of each slot; the slot's offset (capacity,) from its owner's first, -1 where it
        is free; and the number of slots that all owners want.
    """
    ends = jnp.cumsum(counts)
    starts = ends - counts
    # Every owner marks its start; the number of marks up to a slot tells its owner.
    marks = jnp.zeros(capacity, jnp.int32).at[starts].add(1, mode="drop")
    owner = prefix_sums(marks) - 1
    slot = jnp.arange(capacity, dtype=jnp.int32)
    offset = jnp.where(slot < ends[-1], slot - starts[owner], -1)
    return owner, offset, ends[-1]
