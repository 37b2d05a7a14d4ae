"""Batches of views: the tiles of all views are composited as those of one large image."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array

from sfgs_jax.splatting._binning import TileLists


def with_views_as_one(function: Callable[..., Any]) -> Callable[..., Any]:
    """`function(table, lists, *images)`, of which a batch under `vmap` is one call with all views' tiles.

    Batched by JAX, a loop over the blocks of a view would last as long as the longest of any view.

    Args:
        function: of a table (V N, D), of the lists of V T tiles, and of images (V, ...); all that it returns
            has the views, or the rows of the table, as first axis.
    """
    batched = custom_vmap(function)

    @batched.def_vmap
    def of_batch(size: int, is_batched: list[Any], *arguments: Any) -> tuple[Any, Any]:
        def with_axis(x: Array, has_axis: bool) -> Array:
            return x if has_axis else jnp.broadcast_to(x, (size, *x.shape))

        table, lists, *images = jax.tree.map(with_axis, arguments, tuple(is_batched))
        out = batched(_stacked(table), _side_by_side(lists, table.shape[1]), *map(_stacked, images))
        split = jax.tree.map(lambda x: x.reshape(size, -1, *x.shape[1:]), out)
        return split, jax.tree.map(lambda _: True, out)

    return batched


def _stacked(x: Array) -> Array:
    """The first two axes as one."""
    return x.reshape(-1, *x.shape[2:])


def _side_by_side(lists: TileLists, rows: int) -> TileLists:
    """The lists of a batch, each of a table with so many rows, as those of one table with all rows."""
    size, pairs = lists.gaussians.shape
    number = jnp.arange(size, dtype=jnp.int32)[:, None]
    return TileLists(
        gaussians=_stacked(lists.gaussians + rows * number),
        starts=_stacked(lists.starts + pairs * number),
        counts=_stacked(lists.counts),
        overflow=jnp.sum(lists.overflow),
        needed=jnp.sum(lists.needed),
    )
