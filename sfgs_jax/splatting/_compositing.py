"""Front-to-back compositing of tile lists, and its gradient in closed form.

Tiles are ordered by the length of their lists and taken in blocks. A block walks down its lists, a chunk of
Gaussians per tile and step, until the longest ends or no pixel lets light through. So time follows the number
of pairs, not the room for them, and a step's values stay in the processor's cache.

The i-th Gaussian of a list has U = [[p, q], [0, r]], log opacity o and features f_i. Its opacity at pixel x
is a_i, the transmittance before it t_i, and its weight w_i:

    (u, v) = U (x - centre)              a_i = exp(o - (u² + v²) / 2), at most 0.99, 0 below 1/255.
    t_i = (1 - a_1) ... (1 - a_(i-1))    w_i = t_i a_i, 0 from the first t_(i+1) < 1e-4 on.
    out = sum_i w_i f_i.

The gradient walks the same way and computes a once more. Let g be the cotangent of `out`.

    h_i = w_i <g, f_i>.    dL/df_i = w_i g.    dL/d(exponent_i) = h_i - a_i / (1 - a_i) sum_(j>i) h_j.

The last sum is <g, out> minus the h that were passed, so nothing is kept per Gaussian. The offsets u and v
are linear in x. So a Gaussian's six gradients are combinations of six moments over the tile.

    sum_x dL/d(exponent) [1, x, y, x², xy, y²].

Source: the equations of Kerbl et al., 3D Gaussian splatting, 2023.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Shaped

from sfgs_jax.arrays import stable_argsort
from sfgs_jax.splatting._binning import TileLists, tile_grid
from sfgs_jax.splatting._thresholds import MIN_ALPHA
from sfgs_jax.splatting._view_batches import with_views_as_one

MAX_ALPHA = 0.99
"""No Gaussian is more opaque than this."""

MIN_TRANSMITTANCE = 1e-4
"""A Gaussian that would leave less light than this ends its pixel's list, and is not drawn itself."""


class _Portions(NamedTuple):
    """How much is drawn at once.

    Attributes:
        chunk: Gaussians per tile and step.
        block_pixels: pixels per block.
    """

    chunk: int
    block_pixels: int


_OF_A_CPU = _Portions(chunk=8, block_pixels=16_384)
"""Few enough pixels for the cache, enough to keep the cores busy."""

_OF_AN_ACCELERATOR = _Portions(chunk=16, block_pixels=1_048_576)
"""An image is one block: starting a step costs more there than its empty places. The bound is for memory."""

_NOTHING = -1e4
"""Log opacity of an empty place; its exponential is 0, and unlike -inf it makes no NaN."""


class _Blocks(eqx.Module):
    """Tiles in blocks, longest lists first; the last block is filled up with empty lists.

    Attributes:
        tiles: (blocks * B,) index of each list's tile; the lists that fill up the last block have tile 0.
        places: (T,) position of each tile in `tiles`.
        starts: (blocks, B) position in `TileLists.gaussians` at which each list begins.
        counts: (blocks, B) length of each list.
        centres: (blocks, B, 2) centres of the tiles, pixels (u, v).
        chunk: K, Gaussians per tile and step.
    """

    tiles: Int[Array, " places"]
    places: Int[Array, " t"]
    starts: Int[Array, "blocks b"]
    counts: Int[Array, "blocks b"]
    centres: Float[Array, "blocks b 2"]
    chunk: int = eqx.field(static=True)


def _make_blocks(
    lists: TileLists, grid: tuple[int, int], tile_size: int, dtype: jnp.dtype, portions: _Portions
) -> _Blocks:
    """Blocks of the tiles of one or more images, each with so many columns and rows of tiles."""
    tiles, capacity, (columns, rows) = lists.counts.shape[0], lists.gaussians.shape[0], grid
    # Blocks of one size, so that the last is not mostly empty lists.
    blocks = -(-tiles // max(1, portions.block_pixels // tile_size**2))
    size = -(-tiles // blocks)
    order = stable_argsort((capacity - lists.counts).astype(jnp.uint32))
    empty = -tiles % size

    def blocked(values: Array) -> Array:
        values = jnp.pad(values[order], [(0, empty)] + [(0, 0)] * (values.ndim - 1))
        return values.reshape(-1, size, *values.shape[1:])

    index = jnp.arange(tiles, dtype=jnp.int32)
    corners = jnp.stack([index % columns, index // columns % rows], axis=-1) * tile_size
    return _Blocks(
        tiles=blocked(index).reshape(-1),
        places=jnp.zeros(tiles, jnp.int32).at[order].set(index),
        starts=blocked(lists.starts),
        counts=blocked(lists.counts),
        centres=blocked(corners.astype(dtype) + (tile_size - 1) / 2),
        chunk=portions.chunk,
    )


def _pixel_offsets(tile_size: int) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
    """Offsets of a tile's pixels from its centre, along u and along v, row by row."""
    axis = np.arange(tile_size) - (tile_size - 1) / 2
    return np.tile(axis, tile_size), np.repeat(axis, tile_size)


def _moment_basis(tile_size: int, dtype: jnp.dtype) -> Float[Array, "p 6"]:
    """1, x, y, x², xy, y² of the pixels' offsets."""
    x, y = _pixel_offsets(tile_size)
    return jnp.asarray(np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1), dtype)


class _Chunk(eqx.Module):
    """The next K Gaussians of each of B lists.

    Attributes:
        u: (B, K) columns of the centres relative to the tiles', pixels.
        v: (B, K) rows of the centres relative to the tiles', pixels.
        p: (B, K) first entries of the whitening.
        q: (B, K) second entries of the whitening.
        r: (B, K) third entries of the whitening.
        log_opacity: (B, K) logarithms of the opacities.
        features: (B, K, C) values to composite.
    """

    u: Float[Array, "b k"]
    v: Float[Array, "b k"]
    p: Float[Array, "b k"]
    q: Float[Array, "b k"]
    r: Float[Array, "b k"]
    log_opacity: Float[Array, "b k"]
    features: Float[Array, "b k c"]


def _indices(lists: TileLists, blocks: _Blocks, block: Array, step: Array, past: int) -> Int[Array, "b k"]:
    """Indices of a block's Gaussians at a step; `past` where the list has ended.

    Loops carry them from one step to the next. If they were computed at their use, XLA would look each up
    again for every column of the table.
    """
    place = step * blocks.chunk + jnp.arange(blocks.chunk, dtype=jnp.int32)[None]
    live = place < blocks.counts[block][:, None]
    at = jnp.where(live, blocks.starts[block][:, None] + place, 0)
    return jnp.where(live, lists.gaussians[at], past)


def _fetch(table: Float[Array, "n d"], index: Int[Array, "b k"], centres: Float[Array, "b 2"]) -> _Chunk:
    """Rows of the table as a chunk; indices past the table give transparent Gaussians."""
    rows = table.at[index].get(mode="clip")
    return _Chunk(
        u=rows[..., 0] - centres[:, :1],
        v=rows[..., 1] - centres[:, 1:],
        p=rows[..., 2],
        q=rows[..., 3],
        r=rows[..., 4],
        log_opacity=jnp.where(index < table.shape[0], rows[..., 5], _NOTHING),
        features=rows[..., 6:],
    )


def _alphas(chunk: _Chunk, tile_size: int) -> Float[Array, "b k p"]:
    """Opacities a of a chunk's Gaussians at every pixel of their tiles."""
    x, y = (jnp.asarray(offsets, chunk.u.dtype) for offsets in _pixel_offsets(tile_size))
    u0, v0 = -(chunk.p * chunk.u + chunk.q * chunk.v), -chunk.r * chunk.v
    x, y = x[None, None], y[None, None]
    u = u0[..., None] + chunk.p[..., None] * x + chunk.q[..., None] * y
    v = v0[..., None] + chunk.r[..., None] * y
    alphas = jnp.exp(chunk.log_opacity[..., None] - 0.5 * (u * u + v * v))
    return jnp.where(alphas < MIN_ALPHA, 0, jnp.minimum(alphas, MAX_ALPHA))


def _to_images(
    tiled: Shaped[Array, "c blocks b p"], blocks: _Blocks, width: int, height: int, tile_size: int
) -> Shaped[Array, "v c h w"]:
    """The images whose tiles lie in blocks."""
    columns, rows = tile_grid(width, height, tile_size)
    channels = tiled.shape[0]
    tiles = tiled.reshape(channels, -1, tile_size**2)[:, blocks.places]
    grid = tiles.reshape(channels, -1, rows, columns, tile_size, tile_size).transpose(1, 0, 2, 4, 3, 5)
    return grid.reshape(-1, channels, rows * tile_size, columns * tile_size)[:, :, :height, :width]


def _to_tiles(
    images: Float[Array, "v c h w"], blocks: _Blocks, tile_size: int
) -> Float[Array, "c blocks b p"]:
    """The tiles of images in blocks, zero beyond the images."""
    views, channels, height, width = images.shape
    columns, rows = tile_grid(width, height, tile_size)
    room = (0, rows * tile_size - height), (0, columns * tile_size - width)
    padded = jnp.pad(images, ((0, 0), (0, 0), *room))
    grid = padded.reshape(views, channels, rows, tile_size, columns, tile_size).transpose(1, 0, 2, 4, 3, 5)
    tiles = grid.reshape(channels, -1, tile_size**2)
    return tiles[:, blocks.tiles].reshape(channels, *blocks.counts.shape, tile_size**2)


@partial(jax.custom_vjp, nondiff_argnums=(2, 3, 4))
def composite(
    table: Float[Array, "n d"], lists: TileLists, width: int, height: int, tile_size: int
) -> tuple[Float[Array, "d-5 {height} {width}"], Int[Array, "{height} {width}"]]:
    """Composite the features of the Gaussians front to back.

    Reverse-mode differentiable once, in `table`. Under `vmap` the tiles of all views are drawn together.

    Args:
        table: (N, 6 + C) centre u, v, whitening p, q, r, log opacity, then C features.
        lists: the Gaussians of each tile.
        width: of the image, pixels; static.
        height: of the image, pixels; static.
        tile_size: pixels; static.

    Returns:
        image: (C + 1, H, W) sums of weights times features, and last the sums of the weights.
        passed: (H, W) number of Gaussians at the head of a pixel's list that together let more than half of
            the light through.
    """
    return _forward(table, lists, width, height, tile_size)[0]


def _forward(
    table: Float[Array, "n d"], lists: TileLists, width: int, height: int, tile_size: int
) -> tuple[tuple[Array, Array], tuple]:
    """The images, and what the gradient needs."""
    draw = _of_views(_draw, width=width, height=height, tile_size=tile_size)
    images, passed = draw(table, lists)
    return (images[0], passed[0]), (table, lists, images)


def _backward(width: int, height: int, tile_size: int, residuals: tuple, cotangents: tuple) -> tuple:
    """The gradient by the table; the lists have none."""
    walk = _of_views(_walk, width=width, height=height, tile_size=tile_size)
    return walk(*residuals, cotangents[0][None]), None


composite.defvjp(_forward, _backward)


def _of_views(function: Callable[..., Any], **sizes: int) -> Callable[..., Any]:
    """`function` for the tiles of one or more views, in the portions that suit what it is compiled for."""
    on_a_cpu, elsewhere = (
        partial(function, portions=portions, **sizes) for portions in (_OF_A_CPU, _OF_AN_ACCELERATOR)
    )

    def of_platform(*arguments: Any) -> Any:
        return jax.lax.platform_dependent(*arguments, cpu=on_a_cpu, default=elsewhere)

    return with_views_as_one(of_platform)


def _draw(
    table: Float[Array, "n d"],
    lists: TileLists,
    *,
    portions: _Portions,
    width: int,
    height: int,
    tile_size: int,
) -> tuple[Float[Array, "v c h w"], Int[Array, "v h w"]]:
    """Both images of `composite`, of each view."""
    blocks = _make_blocks(lists, tile_grid(width, height, tile_size), tile_size, table.dtype, portions)
    count, size = blocks.counts.shape
    pixels, channels = tile_size**2, table.shape[1] - 5
    indices = partial(_indices, lists, blocks, past=table.shape[0])

    def draw_block(block: Array, images: tuple[Array, Array]) -> tuple[Array, Array]:
        longest = jnp.max(blocks.counts[block])

        def more(state: tuple[Array, ...]) -> Array:
            step, _, transmittance, _, _ = state
            return (step * blocks.chunk < longest) & jnp.any(transmittance >= MIN_TRANSMITTANCE)

        def draw(state: tuple[Array, ...]) -> tuple[Array, ...]:
            step, index, transmittance, out, passed = state
            chunk = _fetch(table, index, blocks.centres[block])
            alphas = _alphas(chunk, tile_size)
            features = jnp.concatenate([chunk.features, jnp.ones_like(chunk.features[..., :1])], axis=-1)
            features = features.transpose(1, 2, 0)[..., None]
            for i in range(blocks.chunk):
                after = transmittance * (1 - alphas[:, i])
                weight = jnp.where(after >= MIN_TRANSMITTANCE, transmittance * alphas[:, i], 0)
                out = out + features[i] * weight[None]
                passed = passed + (after > 0.5).astype(jnp.int32)
                transmittance = after
            return step + 1, indices(block, step + 1), transmittance, out, passed

        first = jnp.int32(0)
        start = (
            first,
            indices(block, first),
            jnp.ones((size, pixels), table.dtype),
            jnp.zeros((channels, size, pixels), table.dtype),
            jnp.zeros((size, pixels), jnp.int32),
        )
        drawn = jax.lax.while_loop(more, draw, start)[-2:]
        return images[0].at[:, block].set(drawn[0]), images[1].at[0, block].set(drawn[1])

    empty = jnp.zeros((channels, count, size, pixels), table.dtype)
    images = jax.lax.fori_loop(0, count, draw_block, (empty, jnp.zeros_like(empty[:1], jnp.int32)))
    image, passed = (_to_images(tiled, blocks, width, height, tile_size) for tiled in images)
    return image, passed[:, 0]


def _walk(
    table: Float[Array, "n d"],
    lists: TileLists,
    images: Float[Array, "v c h w"],
    cotangents: Float[Array, "v c h w"],
    *,
    portions: _Portions,
    width: int,
    height: int,
    tile_size: int,
) -> Float[Array, "n d"]:
    """Gradient by the table: the lists are walked once more, nearest first."""
    blocks = _make_blocks(lists, tile_grid(width, height, tile_size), tile_size, table.dtype, portions)
    count, size = blocks.counts.shape
    # <g, out> of every pixel goes along as one more channel.
    total = jnp.sum(cotangents * images, axis=1, keepdims=True)
    in_tiles = _to_tiles(jnp.concatenate([cotangents, total], axis=1), blocks, tile_size)
    indices = partial(_indices, lists, blocks, past=table.shape[0])

    def walk_block(block: Array, gradients: Array) -> Array:
        longest = jnp.max(blocks.counts[block])
        *by_features, by_alpha, total = in_tiles[:, block]
        stacked = jnp.stack(by_features, axis=1)

        def more(state: tuple[Array, ...]) -> Array:
            step, _, transmittance, _, _ = state
            return (step * blocks.chunk < longest) & jnp.any(transmittance >= MIN_TRANSMITTANCE)

        def walk(state: tuple[Array, ...]) -> tuple[Array, ...]:
            step, index, transmittance, behind, gradients = state
            chunk = _fetch(table, index, blocks.centres[block])
            alphas = _alphas(chunk, tile_size)
            weights, transmittance = _weights(alphas, transmittance)
            toward = _toward(chunk, by_features, by_alpha)
            d_exponent, behind = _exponent_gradients(alphas, weights, toward, behind)
            rows = _row_gradients(chunk, d_exponent, weights, stacked, tile_size)
            gradients = gradients.at[index].add(rows, mode="drop")
            return step + 1, indices(block, step + 1), transmittance, behind, gradients

        first = jnp.int32(0)
        transmittance = jnp.ones((size, tile_size**2), table.dtype)
        start = (first, indices(block, first), transmittance, total, gradients)
        return jax.lax.while_loop(more, walk, start)[-1]

    return jax.lax.fori_loop(0, count, walk_block, jnp.zeros_like(table))


def _weights(
    alphas: Float[Array, "b k p"], transmittance: Float[Array, "b p"]
) -> tuple[Float[Array, "b k p"], Float[Array, "b p"]]:
    """Weights w of a chunk, and the transmittance behind it."""
    before, after = [], []
    for i in range(alphas.shape[1]):
        before.append(transmittance)
        transmittance = transmittance * (1 - alphas[:, i])
        after.append(transmittance)
    kept = jnp.stack(after, axis=1) >= MIN_TRANSMITTANCE
    return jnp.where(kept, jnp.stack(before, axis=1) * alphas, 0), transmittance


def _toward(
    chunk: _Chunk, by_features: list[Float[Array, "b p"]], by_alpha: Float[Array, "b p"]
) -> Float[Array, "b k p"]:
    """<g, f> of a chunk's Gaussians at every pixel."""
    # Channel by channel: a sum over an axis would not fuse.
    toward = by_alpha[:, None]
    for channel, cotangent in enumerate(by_features):
        toward = toward + chunk.features[..., channel, None] * cotangent[:, None]
    return jnp.broadcast_to(toward, (*chunk.u.shape, by_alpha.shape[1]))


def _exponent_gradients(
    alphas: Float[Array, "b k p"],
    weights: Float[Array, "b k p"],
    toward: Float[Array, "b k p"],
    behind: Float[Array, "b p"],
) -> tuple[Float[Array, "b k p"], Float[Array, "b p"]]:
    """dL/d(exponent) of a chunk, and the sum of h over what lies behind it."""
    h = weights * toward
    left = []
    for i in range(alphas.shape[1]):
        behind = behind - h[:, i]
        left.append(behind)
    moves = (weights > 0) & (alphas < MAX_ALPHA)
    return jnp.where(moves, h - alphas / (1 - alphas) * jnp.stack(left, axis=1), 0), behind


def _row_gradients(
    chunk: _Chunk,
    d_exponent: Float[Array, "b k p"],
    weights: Float[Array, "b k p"],
    by_features: Float[Array, "b c p"],
    tile_size: int,
) -> Float[Array, "b k c+6"]:
    """Gradients of a chunk's rows of the table, summed over the pixels.

    The gradients of centre and whitening are small differences of the moments, so both products need the
    highest precision.
    """
    basis = _moment_basis(tile_size, d_exponent.dtype)
    moments = jnp.einsum("bkp,pm->bkm", d_exponent, basis, precision=jax.lax.Precision.HIGHEST)
    d_features = jnp.einsum("bkp,bcp->bck", weights, by_features, precision=jax.lax.Precision.HIGHEST)
    return jnp.concatenate([_from_moments(chunk, moments), d_features.transpose(0, 2, 1)], axis=-1)


def _from_moments(chunk: _Chunk, moments: Float[Array, "b k 6"]) -> Float[Array, "b k 6"]:
    """Gradients of centre, whitening and log opacity from the six moments of dL/d(exponent)."""
    s, sx, sy, sxx, sxy, syy = (moments[..., i] for i in range(6))
    p, q, r = chunk.p, chunk.q, chunk.r
    u0, v0 = -(p * chunk.u + q * chunk.v), -r * chunk.v
    # Sums of dL/d(exponent) times u, v, u (x - x0), u (y - y0), v (y - y0), with (x0, y0) the centre.
    su, sv = u0 * s + p * sx + q * sy, v0 * s + r * sy
    sux = u0 * sx + p * sxx + q * sxy - chunk.u * su
    suy = u0 * sy + p * sxy + q * syy - chunk.v * su
    svy = v0 * sy + r * syy - chunk.v * sv
    return jnp.stack([p * su, q * su + r * sv, -sux, -suy, -svy, s], axis=-1)
