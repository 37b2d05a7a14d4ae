"""Rigid motion that lays matched points on each other, in closed form."""

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float

# Horn's matrix N as a linear map of the entries S[a, b] = sum of source[a] target[b], wxyz.
_HORN = np.zeros((4, 4, 3, 3))
_HORN[0, 0, range(3), range(3)] = 1
for _a, _b, _c in [(0, 1, 2), (1, 2, 0), (2, 0, 1)]:
    _HORN[0, 1 + _a, _b, _c] = _HORN[1 + _a, 0, _b, _c] = 1
    _HORN[0, 1 + _a, _c, _b] = _HORN[1 + _a, 0, _c, _b] = -1
    _HORN[1 + _a, 1 + _a, [_a, _b, _c], [_a, _b, _c]] = 1, -1, -1
    _HORN[1 + _a, 1 + _b, [_a, _b], [_b, _a]] = _HORN[1 + _b, 1 + _a, [_a, _b], [_b, _a]] = 1


def closed_form(
    source: Float[Array, "N 3"], target: Float[Array, "N 3"], weights: Float[Array, " N"]
) -> tuple[jaxlie.SE3, Bool[Array, ""]]:
    """T that minimises the sum of w ||T p - q||², and whether there is only one.

    The rotation is the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix: Horn, Closed-form
    solution of absolute orientation using unit quaternions (JOSA A 1987), section 4. Points on a line, two
    points, one or none leave some of the rotation free: of the rotations that fit equally well this is the
    one closest to none. Never NaN; not differentiable.

    Args:
        source: points p, metres.
        target: points q, metres.
        weights: at least 0.
    """
    total = jnp.sum(weights)
    share = weights / jnp.where(total > 0, total, 1)
    mean_source, mean_target = share @ source, share @ target
    p, q = source - mean_source, target - mean_target
    cross = jnp.einsum("n,na,nb->ab", share, p, q)
    values, vectors = jnp.linalg.eigh(jnp.einsum("ijab,ab->ij", jnp.asarray(_HORN, cross.dtype), cross))
    # Sums of products this small are rounding.
    size = jnp.sqrt((share @ jnp.sum(p**2, axis=1)) * (share @ jnp.sum(q**2, axis=1)))
    tolerance = 1e3 * float(jnp.finfo(cross.dtype).eps) * size
    best = values >= values[3] - tolerance
    unique = (jnp.sum(best, dtype=jnp.int32) == 1) & (size > 0)
    # The identity's part within the eigenvectors that are equally good.
    nearest = vectors @ jnp.where(best, vectors[0], 0)
    length = jnp.sum(nearest**2)
    known = length > 1e-8
    wxyz = jnp.where(known, nearest * jax.lax.rsqrt(jnp.where(known, length, 1)), vectors[:, 3])
    x = jnp.concatenate([wxyz, jnp.zeros(3, wxyz.dtype)])
    turned = _rotate(x[:4], mean_source)
    return jaxlie.SE3(x.at[4:].set(mean_target - turned)), unique


def _rotate(wxyz: Float[Array, "4"], point: Float[Array, "3"]) -> Float[Array, "3"]:
    w, axis = wxyz[0], wxyz[1:]
    across = 2 * jnp.cross(axis, point)
    return point + w * across + jnp.cross(axis, across)
