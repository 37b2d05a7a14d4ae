"""Normal equations of point residuals by moments of the source points."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.gicp.symmetric import SQUARE


def _jacobian_tensor() -> np.ndarray:
    """E of J[a, m] = E[a, m, k] (p, 1)[k]: the Jacobian [I, -[p]x] of exp(delta) p at delta = 0."""
    tensor = np.zeros((3, 6, 4))
    tensor[range(3), range(3), 3] = 1
    for a, b, c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[a, 3 + b, c], tensor[a, 3 + c, b] = 1, -1
    return tensor


_JACOBIAN = _jacobian_tensor()
# Where each entry of a symmetric 4 x 4 matrix stands in the list of its upper triangle.
_PAIRS = np.triu_indices(4)
_PAIR_INDEX = np.zeros((4, 4), np.int32)
_PAIR_INDEX[_PAIRS] = _PAIR_INDEX[_PAIRS[::-1]] = range(10)


def point_moments(points: Float[Array, "3 N"]) -> Float[Array, "10 N"]:
    """Products of the homogeneous coordinates of each point, fixed through an alignment."""
    h = jnp.concatenate([points, jnp.ones_like(points[:1])])
    return jnp.concatenate([h[i] * h[i:] for i in range(4)])


def moment_sums(
    moments: Float[Array, "10 N"], *weights: Float[Array, "... N"]
) -> list[Float[Array, "... 10"]]:
    """Sums over the points of their moments times weights, for several kinds of weights at once.

    One matrix product makes everything that a step needs: XLA adds up a row by itself one number at a time.

    Args:
        moments: `point_moments` of the source points.
        weights: rows of them, each (K, N) or (N,).
    """
    rows = [jnp.atleast_2d(w) for w in weights]
    ends = np.cumsum([len(r) for r in rows])[:-1]
    sums = jnp.split(jnp.concatenate(rows) @ moments.T, ends)
    return [s if w.ndim == 2 else s[0] for s, w in zip(sums, weights, strict=True)]


def pulls(weights: Float[Array, "6 N"], residuals: Float[Array, "3 N"]) -> Float[Array, "3 N"]:
    """W r of every point, with W symmetric, xx xy xz yy yz zz."""
    return jnp.stack([sum(weights[SQUARE[a, b]] * residuals[b] for b in range(3)) for a in range(3)])


def hessian(sums: Float[Array, "6 10"]) -> Float[Array, "6 6"]:
    """J^T W J, from the `moment_sums` of W.

    The residual of a point is r = exp(delta) p - q in source coordinates, so J = [I, -[p]x] is linear in
    (p, 1), and the sum over points is one of weights times products of two coordinates.
    """
    return _hessian(sums[SQUARE])


def gradient(sums: Float[Array, "3 10"]) -> Float[Array, "6"]:
    """J^T W r, from the `moment_sums` of W r."""
    first = sums[:, _PAIR_INDEX[:, 3]]
    return jnp.einsum("amk,ak->m", jnp.asarray(_JACOBIAN, sums.dtype), first)


def isotropic_hessian(sums: Float[Array, "10"]) -> Float[Array, "6 6"]:
    """J^T J times a weight that is the same in all directions, from that weight's `moment_sums`."""
    return _hessian(jnp.eye(3, dtype=sums.dtype)[:, :, None] * sums)


def total(sums: Float[Array, "10"]) -> Float[Array, ""]:
    """Sum of a weight itself, from its `moment_sums`."""
    return sums[_PAIR_INDEX[3, 3]]


def squared_radius(sums: Float[Array, "10"], least: float) -> Float[Array, ""]:
    """Weighted mean of the points' squared distances from the origin; `least` bounds the total weight."""
    return jnp.sum(sums[np.diagonal(_PAIR_INDEX)[:3]]) / jnp.maximum(total(sums), least)


def _hessian(sums: Float[Array, "3 3 10"]) -> Float[Array, "6 6"]:
    jacobian = jnp.asarray(_JACOBIAN, sums.dtype)
    return jnp.einsum("amk,bnl,abkl->mn", jacobian, jacobian, sums[:, :, _PAIR_INDEX])
