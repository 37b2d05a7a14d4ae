"""Products of many small matrices whose lanes lie side by side, the last axis running over the matrices.

Written as sums of a few elementwise products, which fuse into one loop along the lanes.
"""

from functools import reduce
from operator import add

from jaxtyping import Array, Float


def multiply(a: Float[Array, "r k N"], b: Float[Array, "k c N"]) -> Float[Array, "r c N"]:
    """a b, lane by lane."""
    return reduce(add, [a[:, k, None] * b[k] for k in range(a.shape[1])])


def multiply_transposed(a: Float[Array, "k r N"], b: Float[Array, "k c N"]) -> Float[Array, "r c N"]:
    """a^T b, lane by lane."""
    return reduce(add, [a[k, :, None] * b[k] for k in range(a.shape[0])])


def apply(a: Float[Array, "r k N"], b: Float[Array, "k N"]) -> Float[Array, "r N"]:
    """a b for vectors b, lane by lane."""
    return reduce(add, [a[:, k] * b[k] for k in range(a.shape[1])])


def apply_transposed(a: Float[Array, "k r N"], b: Float[Array, "k N"]) -> Float[Array, "r N"]:
    """a^T b for vectors b, lane by lane."""
    return reduce(add, [a[k] * b[k] for k in range(a.shape[0])])
