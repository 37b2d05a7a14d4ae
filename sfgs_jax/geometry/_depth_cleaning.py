"""Depth that can be none: missing, not finite, or beyond what single precision can square."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import checked

_NEAREST, _FARTHEST = 1e-6, 1e6
"""Metres, of depth that can be one."""


@checked
def has_depth(depth: Float[Array | np.ndarray, "*n"]) -> Bool[Array | np.ndarray, "*n"]:
    """Pixels whose depth in metres is one: not missing, and within what single precision can square.

    Depth below a micrometre or beyond 1000 km counts as missing.
    """
    return (depth > _NEAREST) & (depth < _FARTHEST)


@checked
def clean_depth(depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """Depth with everything set to 0 that is none by `has_depth`, and the mask of what is left."""
    valid = jnp.asarray(has_depth(depth))
    return jnp.where(valid, depth, 0), valid
