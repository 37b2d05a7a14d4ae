"""Depth that is noise: its pixels scatter far more than those of any depth camera."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

_FAR = 2.5
"""Depth up to which scatter may grow with depth, and beyond which with its square, metres. Time of flight is
noisy like the one, triangulation like the other."""
_BENDS = 6**0.5
"""Standard deviation of a - 2 b + c, in those of a, b and c."""
_MEDIAN = 0.6745
"""Median of the absolute value of a normal variable, in standard deviations."""


def is_noise(depth: Float[Array, "H W"], most: Float[Array, ""] | float) -> Bool[Array, ""]:
    """True if the depth of most pixels scatters around that of their neighbours by more than a share of it.

    Inverse depth is linear across a plane. So the scatter is what it bends by between three pixels of a row:
    the median, which the edges of things don't reach. Images with too few pixels to tell are no noise.

    Args:
        depth: metres along z, 0 where missing.
        most: largest standard deviation of a pixel up to `_FAR`, as a share of its depth.
    """
    rows = depth[::2]
    left, centre, right = rows[:, :-2:2], rows[:, 1:-1:2], rows[:, 2::2]
    known = (left > 0) & (centre > 0) & (right > 0)
    bend = centre / jnp.where(known, left, 1) + centre / jnp.where(known, right, 1) - 2
    limit = most * jnp.maximum(1, centre / _FAR) * _BENDS * _MEDIAN
    beyond = known & (jnp.abs(bend) > limit)
    return 2 * jnp.sum(beyond, dtype=jnp.int32) > jnp.sum(known, dtype=jnp.int32)
