"""Absolute orientation: the rigid motion between matched points, in closed form."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import se3
from sfgs_jax.gicp._exact_products import exact_products


def _quaternion_tensor() -> np.ndarray:
    """Horn's symmetric 4 x 4 matrix N (wxyz) as a linear map of the correlation S[a, b] = sum p[a] q[b]."""
    tensor = np.zeros((4, 4, 3, 3))
    tensor[0, 0, range(3), range(3)] = 1
    for a, b, c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
        tensor[0, 1 + a, b, c] = tensor[1 + a, 0, b, c] = 1
        tensor[0, 1 + a, c, b] = tensor[1 + a, 0, c, b] = -1
        tensor[1 + a, 1 + a, [a, b, c], [a, b, c]] = 1, -1, -1
        tensor[1 + a, 1 + b, [a, b], [b, a]] = tensor[1 + b, 1 + a, [a, b], [b, a]] = 1
    return tensor


_QUATERNION_MATRIX = _quaternion_tensor()


@exact_products
def absolute_orientation(
    source: Float[Array, "N 3"], target: Float[Array, "N 3"], weights: Float[Array, " N"]
) -> tuple[jaxlie.SE3, Bool[Array, ""]]:
    """T that minimises the sum of w ||T p - q||², and whether there is only one.

    The rotation is the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix. Source: Horn,
    Closed-form solution of absolute orientation using unit quaternions (JOSA A 1987), section 4. Fewer than
    three points, or points on a line, leave some of the rotation free. The result is then the smallest of the
    rotations that fit equally well. Never NaN; not differentiable.

    Args:
        source: points p, metres.
        target: points q, metres.
        weights: at least 0.
    """
    total = jnp.sum(weights)
    share = weights / jnp.where(total > 0, total, 1)
    mean_source, mean_target = share @ source, share @ target
    p, q = source - mean_source[None], target - mean_target[None]
    correlation = jnp.einsum("n,na,nb->ab", share, p, q)
    matrix = jnp.einsum("ijab,ab->ij", jnp.asarray(_QUATERNION_MATRIX, correlation.dtype), correlation)
    values, vectors = jnp.linalg.eigh(matrix)
    # Sums of products this small are rounding.
    size = jnp.sqrt((share @ jnp.sum(p**2, axis=1)) * (share @ jnp.sum(q**2, axis=1)))
    tolerance = 1e3 * float(jnp.finfo(correlation.dtype).eps) * size
    best = values >= values[3] - tolerance
    unique = (jnp.sum(best, dtype=jnp.int32) == 1) & (size > 0)
    # The smallest rotation is the identity's projection on the eigenvectors that are equally good.
    nearest = vectors @ jnp.where(best, vectors[0], 0)
    length = jnp.sum(nearest**2)
    known = length > 1e-8
    wxyz = jnp.where(known, nearest * jax.lax.rsqrt(jnp.where(known, length, 1)), vectors[:, 3])
    x = jnp.concatenate([wxyz, jnp.zeros(3, wxyz.dtype)])
    turned = se3.rotate(x[:4], mean_source)
    return jaxlie.SE3(x.at[4:].set(mean_target - turned)), unique
