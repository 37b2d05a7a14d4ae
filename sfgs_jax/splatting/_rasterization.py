"""Rasterisation of projected Gaussians with any features: tile binning, then compositing."""

from functools import partial
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.splatting._binning import Occluder, TileLists, bin_into_tiles, tile_grid
from sfgs_jax.splatting._compositing import composite
from sfgs_jax.splatting._config import DEFAULT, RenderConfig
from sfgs_jax.splatting._projection import Projected

_Arrays = TypeVar("_Arrays")


class Raster(eqx.Module):
    """Composited features.

    Attributes:
        accumulated: (H, W, C) sums over the Gaussians of weight times feature.
        alpha: (H, W) sums of the weights, in [0, 1].
        median: (H, W) index of the Gaussian at which the transmittance falls to one half; -1 where it stays
            above.
        overflow: number of (tile, Gaussian) pairs that found no room; 0 when the images are complete.
        needed: room for pairs that the images need, at least so much where some found none.
    """

    accumulated: Float[Array, "h w c"]
    alpha: Float[Array, "h w"]
    median: Int[Array, "h w"]
    overflow: Int[Array, ""]
    needed: Int[Array, ""]


@checked
def rasterize(
    projected: Projected,
    features: Float[Array, "n c"],
    *,
    width: int,
    height: int,
    occluder: Occluder | None = None,
    config: RenderConfig = DEFAULT,
) -> Raster:
    """Composite the features of the Gaussians front to back.

    Reverse-mode differentiable once, in `projected` and `features`. There is no forward mode, because the
    gradient is written by hand.

    Args:
        projected: images of N Gaussians.
        features: (N, C) colours, depths or anything else to composite. Lanes that are not visible may hold
            anything.
        width: of the image, pixels; static.
        height: of the image, pixels; static.
        occluder: what hides some of the Gaussians.
        config: settings, static; only `tile_size` and `pair_capacity` have an influence.

    Raises:
        InputError: `features` does not have one row for each Gaussian.
    """
    require_rows("features", features, projected.visible.shape[0])
    if features.shape[0] == 0:
        projected, features = with_a_free_slot((projected, features))
    return _rasterize(projected, features, width, height, occluder, config)


# Compiled here: hundreds of small programs would take longer. Inside a caller's jit it is inlined.
@partial(jax.jit, static_argnames=("width", "height", "config"))
def _rasterize(
    projected: Projected,
    features: Float[Array, "n c"],
    width: int,
    height: int,
    occluder: Occluder | None,
    config: RenderConfig,
) -> Raster:
    lists = bin_into_tiles(
        *jax.lax.stop_gradient((projected, occluder)),
        width=width,
        height=height,
        tile_size=config.tile_size,
        pair_capacity=config.pair_capacity,
    )
    features = jnp.where(projected.visible[:, None], features, 0)
    columns = [projected.centres, projected.whitening, projected.log_opacities[:, None]]
    table = jnp.concatenate([*columns, features], axis=-1)
    images: tuple[Array, Array] = composite(table, lists, width, height, config.tile_size)
    image, passed = images
    return Raster(
        accumulated=jnp.moveaxis(image[:-1], 0, -1),
        alpha=image[-1],
        median=_median(passed, lists, width, height, config.tile_size),
        overflow=lists.overflow,
        needed=lists.needed,
    )


def require_rows(name: str, values: Array, count: int) -> None:
    """Raise InputError unless `values` has one row for each of `count` Gaussians."""
    if values.ndim != 2 or values.shape[0] != count:
        raise InputError(
            f"{name} have shape {values.shape}; {count} Gaussians need one row each, ({count}, channels)."
        )


def with_a_free_slot(arrays: _Arrays) -> _Arrays:
    """Arrays with one more row of zeros, neither valid nor visible: compositing needs at least one row."""
    return jax.tree.map(lambda x: jnp.pad(x, [(0, 1)] + [(0, 0)] * (x.ndim - 1)), arrays)


def _median(
    passed: Int[Array, "h w"], lists: TileLists, width: int, height: int, tile_size: int
) -> Int[Array, "h w"]:
    """Index of the Gaussian that follows the first `passed` of each pixel's list; -1 where the list ends."""
    columns, _ = tile_grid(width, height, tile_size)
    rows = jnp.arange(height, dtype=jnp.int32) // tile_size
    tile = rows[:, None] * columns + jnp.arange(width, dtype=jnp.int32)[None] // tile_size
    found = passed < lists.counts[tile]
    place = jnp.where(found, lists.starts[tile] + passed, 0)
    return jnp.where(found, lists.gaussians[place], -1)
