"""Normal equations of point residuals by moments of the source points."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.gicp.residuals import COLUMNS, ROWS


def _jacobian_tensor() -> np.ndarray:
    """E of J[a, m] = E[a, m, k] (p, 1)[k]: the Jacobian [I, -[p]x] of exp(delta) p at delta = 0."""
    tensor = np.zeros((3, 6, 4))
    tensor[range(3), range(3), 3] = 1
    for a, b, c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[a, 3 + b, c], tensor[a, 3 + c, b] = 1, -1
    return tensor


_JACOBIAN = _jacobian_tensor()
# Where each entry of a symmetric 3 x 3 (4 x 4) matrix stands in the list of its upper triangle.
_WEIGHT_INDEX = np.zeros((3, 3), np.int32)
_WEIGHT_INDEX[ROWS, COLUMNS] = _WEIGHT_INDEX[COLUMNS, ROWS] = range(6)
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
    pulls = [sum(weights[_WEIGHT_INDEX[a, b]] * residuals[b] for b in range(3)) for a in range(3)]
    sums = jnp.concatenate([weights, jnp.stack(pulls)]) @ moments.T
    second = sums[_WEIGHT_INDEX][:, :, _PAIR_INDEX]
    first = sums[6:][:, _PAIR_INDEX[:, 3]]
    jacobian = jnp.asarray(_JACOBIAN, moments.dtype)
    hessian = jnp.einsum("amk,bnl,abkl->mn", jacobian, jacobian, second)
    return hessian, jnp.einsum("amk,ak->m", jacobian, first)
