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
    homogeneous = jnp.concatenate([points, jnp.ones_like(points[:1])])
    return jnp.stack([homogeneous[i] * homogeneous[j] for i, j in zip(*_PAIRS, strict=True)])


def normal_equations(
    moments: Float[Array, "10 N"], weights: Float[Array, "6 N"], residuals: Float[Array, "3 N"]
) -> tuple[Float[Array, "6 6"], Float[Array, "6"]]:
    """Hessian J^T W J and gradient J^T W r of half the sum of r^T W r over points.

    The residual of a point is r = exp(delta) p - q in source coordinates, so J = [I, -[p]x] is linear in
    (p, 1) and every sum is of a weight times a product of two coordinates: one matrix product.

    Args:
        moments: `point_moments` of the source points p.
        weights: symmetric 3 x 3 weights, xx xy xz yy yz zz; 0 leaves a point out.
        residuals: p - q, metres.
    """
    pulls = [sum(weights[SQUARE[a, b]] * residuals[b] for b in range(3)) for a in range(3)]
    sums = jnp.concatenate([weights, jnp.stack(pulls)]) @ moments.T
    first = sums[6:][:, _PAIR_INDEX[:, 3]]
    gradient = jnp.einsum("amk,ak->m", jnp.asarray(_JACOBIAN, moments.dtype), first)
    return _hessian(sums[SQUARE]), gradient


def isotropic_hessian(moments: Float[Array, "10 N"], weights: Float[Array, " N"]) -> Float[Array, "6 6"]:
    """Hessian where all directions of a point's residual weigh alike."""
    sums = weights @ moments.T
    return _hessian(jnp.eye(3, dtype=moments.dtype)[:, :, None] * sums)


def _hessian(sums: Float[Array, "3 3 10"]) -> Float[Array, "6 6"]:
    jacobian = jnp.asarray(_JACOBIAN, sums.dtype)
    return jnp.einsum("amk,bnl,abkl->mn", jacobian, jacobian, sums[:, :, _PAIR_INDEX])
