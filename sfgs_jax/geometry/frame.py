"""One RGB-D image pair, the unit that recordings yield and the system consumes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float


class Frame(eqx.Module):
    """Colour image with a depth image registered to it.

    Attributes:
        rgb: (H, W, 3) float32 RGB in [0, 1].
        depth: (H, W) float32 metres along z; 0 where missing.
        timestamp: seconds; a Python float, because float32 can't hold a Unix time stamp.
    """

    rgb: Float[Array | np.ndarray, "H W 3"]
    depth: Float[Array | np.ndarray, "H W"]
    timestamp: float


def clean_depth(depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """Depth with everything not finite or not positive set to 0, and the mask of what is left."""
    valid = jnp.isfinite(depth) & (depth > 0)
    return jnp.where(valid, depth, 0), valid
