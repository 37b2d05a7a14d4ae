"""Block-sparse Cholesky factorisation and solution along a plan of elimination."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from sfgs_jax.factor_graph.nested_dissection import EliminationPlan, Level


class Front(eqx.Module):
    """Factorised columns of the nodes at one level.

    Attributes:
        own: (n, 6 o, 6 o) lower Cholesky factors.
        boundary: (n, 6 b, 6 o) columns below them.
    """

    own: Float[Array, "n s s"]
    boundary: Float[Array, "n t s"]


def multifrontal_cholesky(
    plan: EliminationPlan, diagonal: Float[Array, "P 6 6"], off_diagonal: Float[Array, "B 6 6"]
) -> tuple[Front, ...]:
    """Factors of a symmetric block matrix; not finite if it is not positive definite."""
    keep = ~jnp.asarray(plan.transposed)[:, None, None]
    below = jnp.where(keep, off_diagonal, jnp.swapaxes(off_diagonal, 1, 2))
    blocks = jnp.concatenate([diagonal, below]).reshape(-1, 36)
    fronts = []
    updates, child = None, None
    for level in plan.levels:
        own, boundary, corner = _assemble(level, blocks, updates, child, len(diagonal))
        lower = lax.linalg.cholesky(own, symmetrize_input=False)
        columns = lax.linalg.triangular_solve(lower, boundary, lower=True, transpose_a=True)
        fronts.append(Front(lower, columns))
        product = jnp.einsum("nis,njs->nij", columns, columns)
        n, b = level.boundary.shape
        i, j = np.tril_indices(b)
        product = jnp.transpose(product.reshape(n, b, 6, b, 6), (0, 1, 3, 2, 4))[:, i, j]
        updates = -product if corner is None else corner - product
        child = level
    return tuple(fronts)


def _assemble(
    level: Level,
    blocks: Float[Array, "S 36"],
    updates: Float[Array, "c t 6 6"] | None,
    child: Level | None,
    num_poses: int,
) -> tuple[Float[Array, "n s s"], Float[Array, "n b s"], Float[Array, "n u 6 6"] | None]:
    """Fronts of a level: own columns, columns below, and the lower triangle of the boundary's corner."""
    n, o = level.own.shape
    b = level.boundary.shape[1]
    size, triangle = n * (o + b) * o, b * (b + 1) // 2
    front = jnp.zeros((size + 1, 36), blocks.dtype)
    front = front.at[jnp.asarray(level.places)].add(blocks[jnp.asarray(level.sources)])
    corner = None
    if child is not None and updates is not None:
        c = child.boundary.shape[1]
        i, j = np.tril_indices(c)
        positions, parent = jnp.asarray(child.positions), jnp.asarray(child.parent)[:, None]
        row, column = positions[:, i], positions[:, j]
        flat = updates.reshape(-1, 36)
        there = (row < o + b) & (column < o)
        place = jnp.where(there, (parent * (o + b) + row) * o + column, size)
        front = front.at[place.reshape(-1)].add(flat)
        p, q = row - o, column - o
        inside = (row < o + b) & (q >= 0)
        place = jnp.where(inside, parent * triangle + p * (p + 1) // 2 + q, n * triangle)
        corner = jnp.zeros((n * triangle + 1, 36), blocks.dtype).at[place.reshape(-1)].add(flat)
        corner = corner[:-1].reshape(n, triangle, 6, 6)
    columns = jnp.transpose(front[:-1].reshape(n, o + b, o, 6, 6), (0, 1, 3, 2, 4))
    columns = columns.reshape(n, 6 * (o + b), 6 * o)
    unused = jnp.repeat(jnp.asarray(level.own) == num_poses, 6, axis=1)
    own = columns[:, : 6 * o] + jnp.eye(6 * o, dtype=blocks.dtype) * unused[:, None].astype(blocks.dtype)
    return own, columns[:, 6 * o :], corner


def multifrontal_solve(
    plan: EliminationPlan, fronts: tuple[Front, ...], right: Float[Array, "P 6"]
) -> Float[Array, "P 6"]:
    """Solution of the factorised system; not finite if that was not positive definite."""
    # What fails in one front reaches the root. Waiting for it also keeps XLA from running the first fronts'
    # solution beside the last ones' factorisation: two batched LAPACK calls at once, each holding a thread of
    # its pool while waiting for the other threads, end in a deadlock on a machine with two.
    whole = jnp.all(jnp.isfinite(fronts[-1].own))
    vector = jnp.where(whole, jnp.concatenate([right, jnp.zeros_like(right[:1])]), jnp.nan)
    for level, front in zip(plan.levels, fronts, strict=True):
        own, boundary = jnp.asarray(level.own), jnp.asarray(level.boundary)
        part = vector[own].reshape(own.shape[0], -1, 1)
        part = lax.linalg.triangular_solve(front.own, part, left_side=True, lower=True)
        vector = vector.at[own].set(part.reshape(*own.shape, 6))
        below = jnp.sum(front.boundary * jnp.swapaxes(part, 1, 2), axis=2)
        vector = vector.at[boundary].add(-below.reshape(*boundary.shape, 6))
    vector = vector.at[-1].set(0)
    for level, front in zip(reversed(plan.levels), reversed(fronts), strict=True):
        own, boundary = jnp.asarray(level.own), jnp.asarray(level.boundary)
        above = vector[boundary].reshape(boundary.shape[0], -1, 1)
        part = vector[own].reshape(own.shape[0], -1, 1) - jnp.sum(front.boundary * above, axis=1)[:, :, None]
        part = lax.linalg.triangular_solve(front.own, part, left_side=True, lower=True, transpose_a=True)
        vector = vector.at[own].set(part.reshape(*own.shape, 6)).at[-1].set(0)
    return vector[:-1]
