"""One RGB-D image pair, the unit that recordings yield and the system consumes."""

import math
from numbers import Real
from typing import cast

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float, Shaped

from sfgs_jax.arrays import InputError, described, is_array, is_known
from sfgs_jax.geometry._image_checks import require_colour, require_depth

LONGEST_BREAK_S = 3600.0
"""No camera is followed over a longer one: where two stamps are farther apart, one is wrong."""


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
            InputError: an image is no array, is of integers or of another shape, `valid` is no mask of their
                shape, or a time stamp is no finite number.
        """
        require_colour(rgb, "A frame's colour")
        require_depth(depth, (rgb.shape[0], rgb.shape[1]), "A frame's depth", "its colour's")
        if valid is not None and not (is_array(valid) and valid.dtype == bool and valid.shape == depth.shape):
            raise InputError(
                f"A frame's mask of valid pixels is bool of its depth's shape {depth.shape}, not "
                f"{described(valid)}."
            )
        _require_seconds(timestamp, "time stamp")
        if depth_timestamp is not None:
            _require_seconds(depth_timestamp, "time stamp of depth")
        self.rgb, self.depth, self.valid = rgb, depth, valid
        self.timestamp, self.depth_timestamp = timestamp, depth_timestamp

    @property
    def mask(self) -> Bool[Array | np.ndarray, "H W"]:
        """(H, W) pixels that hold an image, all of them where `valid` is None."""
        return np.ones(self.depth.shape, bool) if self.valid is None else self.valid


def _require_seconds(value: object, name: str) -> None:
    """Refuse a time stamp that is no finite number; a traced one may be anything."""
    number = isinstance(value, Real) or (is_array(value) and np.shape(value) == ())
    if number and not is_known(value):
        return
    if not number or isinstance(value, bool) or not math.isfinite(cast(float, value)):
        shown = value if number else described(value)
        raise InputError(f"A frame's {name} is a finite number of seconds, not {shown}.")
