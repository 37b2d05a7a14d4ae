"""Multifrontal Cholesky: block-sparse factorisation and solution along an elimination plan."""

from functools import partial

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.lax import Precision
from jaxtyping import Array, Float, Int

from sfgs_jax.factor_graph.problem._elimination_plan import EliminationPlan, FrontBatch

STRIP = 48
"""Blocks in a strip of a front's boundary: wide enough for products to run at full speed."""


class Front(eqx.Module):
    """Factorised columns of the fronts of one batch, of d x d blocks.

    Attributes:
        own: (n, d o, d o) lower Cholesky factors.
        boundary: (n, d b, d o) columns below them.
    """

    own: Float[Array, "n s s"]
    boundary: Float[Array, "n t s"]


def multifrontal_cholesky(
    plan: EliminationPlan, diagonal: Float[Array, "P d d"], off_diagonal: Float[Array, "B d d"]
) -> tuple[Front, ...]:
    """Multifrontal Cholesky factors of a symmetric block matrix; not finite if it is not positive definite.

    Args:
        plan: elimination plan of its pattern.
        diagonal: (P, d, d) blocks on the diagonal.
        off_diagonal: (B, d, d) blocks above it.
    """
    d = diagonal.shape[1]
    keep = ~jnp.asarray(plan.transposed)[:, None, None]
    below = jnp.where(keep, off_diagonal, jnp.swapaxes(off_diagonal, 1, 2))
    entries = jnp.concatenate([diagonal, below]).reshape(-1, d * d)
    places, end = jnp.asarray(plan.places), _blocks(plan)
    blocks = jnp.zeros((end + 1, d * d), entries.dtype).at[places].set(entries)
    factors, start = [], 0
    for batch in plan.batches:
        (n, o), b = batch.own.shape, batch.boundary.shape[1]
        corner = start + n * (o + b) * o
        columns = blocks[start:corner].reshape(n, o + b, o, d, d)
        columns = jnp.transpose(columns, (0, 1, 3, 2, 4)).reshape(n, d * (o + b), d * o)
        unused = jnp.repeat(jnp.asarray(batch.own) == len(diagonal), d, axis=1).astype(entries.dtype)
        own = columns[:, : d * o] + jnp.eye(d * o, dtype=entries.dtype)[None] * unused[:, None]
        lower = lax.map(partial(lax.linalg.cholesky, symmetrize_input=False), own)
        boundary = _divided(lower, columns[:, d * o :], transpose_a=True)
        factors.append(Front(lower, boundary))
        start = corner + n * (b * (b + 1) // 2)
        if b:
            update = blocks[corner:start] - symmetric_rank_k_blocks(boundary, b).reshape(-1, d * d)
            blocks = blocks.at[_places_in_parents(batch, end)].add(update)
    return tuple(factors)


def _divided(
    lower: Float[Array, "n s s"], right: Float[Array, "n i j"], **sides: bool
) -> Float[Array, "n i j"]:
    """Right-hand sides divided by lower triangular matrices, one after the other.

    A batched call of LAPACK hands its matrices to the threads of the pool, and holds one while it waits for
    them. Two at once, of whatever programs, would wait for each other for ever where there are two threads.
    """
    return lax.map(lambda pair: lax.linalg.triangular_solve(*pair, lower=True, **sides), (lower, right))


def symmetric_rank_k_blocks(
    rows: Float[Array, "n t s"], blocks: int, *, strip: int = STRIP
) -> Float[Array, "n u d d"]:
    """Symmetric rank-k product A A^T of each batch: the d x d blocks of its lower triangle, row by row.

    It is put together from strips of rows, each times the columns up to its end. That leaves out most of the
    upper triangle, and keeps the products large.

    Args:
        rows: (n, t, s) matrices A.
        blocks: number of blocks b in t = b d rows.
        strip: blocks in a strip.
    """
    n, t, _ = rows.shape
    if not blocks:
        return jnp.zeros((n, 0, 1, 1), rows.dtype)
    d = t // blocks
    parts = []
    for low in range(0, blocks, strip):
        high = min(low + strip, blocks)
        i, j = np.tril_indices(high - low, low, high)
        left, right = rows[:, d * low : d * high], rows[:, : d * high]
        product = jnp.einsum("nis,njs->nij", left, right, precision=Precision.HIGHEST)
        product = product.reshape(n, high - low, d, high, d)
        parts.append(jnp.transpose(product, (0, 1, 3, 2, 4))[:, i, j])
    return jnp.concatenate(parts, axis=1)


def _blocks(plan: EliminationPlan) -> int:
    """Number of blocks of all fronts."""
    sizes = [(*batch.own.shape, batch.boundary.shape[1]) for batch in plan.batches]
    return sum(n * ((o + b) * o + b * (b + 1) // 2) for n, o, b in sizes)


def _places_in_parents(batch: FrontBatch, end: int) -> Int[Array, " u"]:
    """Place of the blocks of a batch's triangles in their parents' fronts."""
    i, j = np.tril_indices(batch.boundary.shape[1])
    positions = jnp.asarray(batch.positions)
    columns, triangle, width = (jnp.asarray(x)[:, None] for x in (batch.columns, batch.triangle, batch.width))
    row, column = positions[:, i], positions[:, j]
    p, q = row - width, column - width
    place = jnp.where(q < 0, columns + row * width + column, triangle + p * (p + 1) // 2 + q)
    return jnp.where(row < 0, end, place).reshape(-1)


def multifrontal_solve(
    plan: EliminationPlan, fronts: tuple[Front, ...], right: Float[Array, "P d"]
) -> Float[Array, "P d"]:
    """Solution of the factorised system; not finite if that was not positive definite.

    Args:
        plan: elimination plan.
        fronts: factors of the matrix.
        right: (P, d) right-hand side.
    """
    # A failure in any front reaches the root.
    whole = jnp.all(jnp.isfinite(fronts[-1].own))
    d = right.shape[1]
    vector = jnp.where(whole, jnp.concatenate([right, jnp.zeros_like(right[:1])]), jnp.nan)
    for batch, front in zip(plan.batches, fronts, strict=True):
        own, boundary = jnp.asarray(batch.own), jnp.asarray(batch.boundary)
        part = vector[own].reshape(own.shape[0], -1, 1)
        part = _divided(front.own, part, left_side=True)
        vector = vector.at[own].set(part.reshape(*own.shape, d))
        below = jnp.sum(front.boundary * jnp.swapaxes(part, 1, 2), axis=2)
        vector = vector.at[boundary].add(-below.reshape(*boundary.shape, d))
    vector = vector.at[-1].set(0)
    for batch, front in zip(reversed(plan.batches), reversed(fronts), strict=True):
        own, boundary = jnp.asarray(batch.own), jnp.asarray(batch.boundary)
        above = vector[boundary].reshape(boundary.shape[0], -1, 1)
        part = vector[own].reshape(own.shape[0], -1, 1) - jnp.sum(front.boundary * above, axis=1)[:, :, None]
        part = _divided(front.own, part, left_side=True, transpose_a=True)
        vector = vector.at[own].set(part.reshape(*own.shape, d)).at[-1].set(0)
    return vector[:-1]
