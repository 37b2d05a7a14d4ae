"""One RGB-D image pair, the unit that recordings yield and the system consumes."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from sfgs_jax.arrays import InputError


class Frame(eqx.Module):
    """Colour image with a depth image registered to it.

    Types and shapes are checked, values are not: that would wait for the device.

    Attributes:
        rgb: (H, W, 3) float32 RGB in [0, 1].
        depth: (H, W) float32 metres along z; 0 where missing.
        timestamp: seconds, when colour was exposed; a Python float, because float32 can't hold a Unix time
            stamp.
        depth_timestamp: seconds by the same clock, when depth was exposed; None if that is not known. Then
            the pytree has a leaf less.
        valid: (H, W) pixels that hold an image: not those beyond a lens's field of view. None if all do; then
            the pytree has a leaf less.
    """

    rgb: Float[Array | np.ndarray, "H W 3"]
    depth: Float[Array | np.ndarray, "H W"]
    timestamp: float
    depth_timestamp: float | None
    valid: Bool[Array | np.ndarray, "H W"] | None

    def __init__(
        self,
        rgb: Shaped[Array | np.ndarray, "..."],
        depth: Shaped[Array | np.ndarray, "..."],
        timestamp: float,
        depth_timestamp: float | None = None,
        valid: Shaped[Array | np.ndarray, "..."] | None = None,
    ) -> None:
        """Make a frame of an image pair.

        Args:
            rgb: (H, W, 3) float RGB in [0, 1].
            depth: (H, W) float metres along z; 0 where missing.
            timestamp: seconds, of colour.
            depth_timestamp: seconds, of depth; None if not known.
            valid: (H, W) pixels that hold an image; None if all do.

        Raises:
            InputError: an image is of integers or of another shape, or `valid` is no mask of their shape.
        """
        if not _is_float(rgb) or rgb.ndim != 3 or rgb.shape[2] != 3:
            raise InputError(
                f"A frame's colour is float32 RGB in [0, 1] of shape (H, W, 3), not {rgb.dtype} of shape "
                f"{rgb.shape}; divide an 8-bit image by 255."
            )
        if not _is_float(depth) or depth.shape != rgb.shape[:2]:
            raise InputError(
                f"A frame's depth is float32 metres of its colour's shape {rgb.shape[:2]}, not {depth.dtype} "
                f"of shape {depth.shape}; divide a 16-bit image by its units per metre, 1000 for millimetres."
            )
        if valid is not None and (valid.dtype != bool or valid.shape != depth.shape):
            raise InputError(
                f"A frame's mask of valid pixels is bool of its depth's shape {depth.shape}, not "
                f"{valid.dtype} of shape {valid.shape}."
            )
        self.rgb, self.depth, self.valid = rgb, depth, valid
        self.timestamp, self.depth_timestamp = timestamp, depth_timestamp

    @property
    def mask(self) -> Bool[Array | np.ndarray, "H W"]:
        """(H, W) pixels that hold an image, all of them where `valid` is None."""
        return np.ones(self.depth.shape, bool) if self.valid is None else self.valid


def clean_depth(depth: Float[Array, "*n"]) -> tuple[Float[Array, "*n"], Bool[Array, "*n"]]:
    """Depth with everything not finite or not positive set to 0, and the mask of what is left."""
    valid = jnp.isfinite(depth) & (depth > 0)
    return jnp.where(valid, depth, 0), valid


def _is_float(image: Array | np.ndarray) -> bool:
    return jnp.issubdtype(image.dtype, jnp.floating) and image.dtype.itemsize >= 4
