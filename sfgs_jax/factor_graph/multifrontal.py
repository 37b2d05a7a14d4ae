"""Block-sparse Cholesky factorisation and solution along a plan of elimination."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int

from sfgs_jax.factor_graph.nested_dissection import Batch, EliminationPlan

STRIP = 48
"""Poses in a strip of a front's boundary: wide enough for products to run at full speed."""


class Front(eqx.Module):
    """Factorised columns of the nodes of one batch, of d x d blocks.

    Attributes:
        own: (n, d o, d o) lower Cholesky factors.
        boundary: (n, d b, d o) columns below them.
    """

    own: Float[Array, "n s s"]
    boundary: Float[Array, "n t s"]


def multifrontal_cholesky(
    plan: EliminationPlan, diagonal: Float[Array, "P d d"], off_diagonal: Float[Array, "B d d"]
) -> tuple[Front, ...]:
    """Factors of a symmetric block matrix; not finite if it is not positive definite."""
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
        own = columns[:, : d * o] + jnp.eye(d * o, dtype=entries.dtype) * unused[:, None]
        lower = lax.linalg.cholesky(own, symmetrize_input=False)
        boundary = lax.linalg.triangular_solve(lower, columns[:, d * o :], lower=True, transpose_a=True)
        factors.append(Front(lower, boundary))
        start = corner + n * (b * (b + 1) // 2)
        update = blocks[corner:start] - _triangle_of_square(boundary, b, d).reshape(-1, d * d)
        blocks = blocks.at[_handed_to(batch, end)].add(update)
    return tuple(factors)


def _triangle_of_square(rows: Float[Array, "n t s"], b: int, d: int) -> Float[Array, "n u d d"]:
    """Blocks of the lower triangle of rows rows^T, row by row, in strips that leave most of the upper out."""
    parts = []
    for low in range(0, b, STRIP):
        high = min(low + STRIP, b)
        i, j = np.tril_indices(high - low, low, high)
        product = jnp.einsum("nis,njs->nij", rows[:, d * low : d * high], rows[:, : d * high])
        product = product.reshape(len(rows), high - low, d, high, d)
        parts.append(jnp.transpose(product, (0, 1, 3, 2, 4))[:, i, j])
    return jnp.concatenate(parts, axis=1) if parts else jnp.zeros((len(rows), 0, d, d), rows.dtype)


def _blocks(plan: EliminationPlan) -> int:
    """How many blocks all fronts have."""
    sizes = [(*batch.own.shape, batch.boundary.shape[1]) for batch in plan.batches]
    return sum(n * ((o + b) * o + b * (b + 1) // 2) for n, o, b in sizes)


def _handed_to(batch: Batch, end: int) -> Int[Array, " u"]:
    """Where the blocks of a batch's triangles go in their parents' fronts."""
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
    """Solution of the factorised system; not finite if that was not positive definite."""
    # What fails in one front reaches the root. Waiting for it also keeps XLA from running the first fronts'
    # solution beside the last ones' factorisation: two batched LAPACK calls at once, each holding a thread of
    # its pool while waiting for the other threads, end in a deadlock on a machine with two.
    whole = jnp.all(jnp.isfinite(fronts[-1].own))
    d = right.shape[1]
    vector = jnp.where(whole, jnp.concatenate([right, jnp.zeros_like(right[:1])]), jnp.nan)
    for batch, front in zip(plan.batches, fronts, strict=True):
        own, boundary = jnp.asarray(batch.own), jnp.asarray(batch.boundary)
        part = vector[own].reshape(own.shape[0], -1, 1)
        part = lax.linalg.triangular_solve(front.own, part, left_side=True, lower=True)
        vector = vector.at[own].set(part.reshape(*own.shape, d))
        below = jnp.sum(front.boundary * jnp.swapaxes(part, 1, 2), axis=2)
        vector = vector.at[boundary].add(-below.reshape(*boundary.shape, d))
    vector = vector.at[-1].set(0)
    for batch, front in zip(reversed(plan.batches), reversed(fronts), strict=True):
        own, boundary = jnp.asarray(batch.own), jnp.asarray(batch.boundary)
        above = vector[boundary].reshape(boundary.shape[0], -1, 1)
        part = vector[own].reshape(own.shape[0], -1, 1) - jnp.sum(front.boundary * above, axis=1)[:, :, None]
        part = lax.linalg.triangular_solve(front.own, part, left_side=True, lower=True, transpose_a=True)
        vector = vector.at[own].set(part.reshape(*own.shape, d)).at[-1].set(0)
    return vector[:-1]
