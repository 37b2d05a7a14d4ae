"""Checks of images: types and shapes raise, depth that can't be in metres warns."""

import warnings
from typing import Any

import numpy as np

from sfgs_jax.arrays import InputError, described, is_array, is_floating

_PLAUSIBLE_DEPTH = (0.01, 100.0)
"""A median depth out of this range, metres, means that the unit is another."""

_BRIGHTEST = 4.0
"""Colours of more light than an image in [0, 1] holds; 255 means that the unit is another."""

_SAMPLED = 8
"""Every eighth row and column tell an image's median well enough."""


def require_colour(rgb: Any, name: str) -> None:
    """Refuse anything but a floating-point image (H, W, 3).

    Args:
        rgb: the argument.
        name: of it, at the beginning of a sentence.

    Raises:
        InputError: it is something else.
    """
    if not is_floating(rgb) or rgb.ndim != 3 or rgb.shape[2] != 3:
        raise InputError(
            f"{name} is float32 RGB in [0, 1] of shape (H, W, 3), not {described(rgb)}"
            f"{'; divide an 8-bit image by 255' if _is_integer(rgb) else ''}."
        )


def require_depth(depth: Any, shape: tuple[int, int], name: str, owner: str) -> None:
    """Refuse anything but a floating-point image of a shape.

    Args:
        depth: the argument.
        shape: rows and columns that it must have.
        name: of it, at the beginning of a sentence.
        owner: of the shape, for the message: "its camera's".

    Raises:
        InputError: it is something else.
    """
    if not is_floating(depth) or depth.shape != shape:
        hint = "; divide a 16-bit image by its units per metre, 1000 for millimetres"
        raise InputError(
            f"{name} is float32 metres of {owner} shape {shape}, not {described(depth)}"
            f"{hint if _is_integer(depth) else ''}."
        )


def warn_unless_metres(depth: Any) -> None:
    """Warn if the median of a depth image is so far from a room's that its unit must be another.

    Args:
        depth: (H, W) metres; 0 where missing. An image on the device is waited for.
    """
    sample = np.asarray(depth[::_SAMPLED, ::_SAMPLED] if isinstance(depth, np.ndarray) else depth)
    present = sample[np.isfinite(sample) & (sample > 0)].astype(np.float64)
    low, high = _PLAUSIBLE_DEPTH
    if len(present) and not low <= (median := float(np.median(present))) <= high:
        warnings.warn(
            f"The median depth is {median:.3g} m, but depth is in metres: "
            "divide the image by its units per metre, 1000 for millimetres.",
            stacklevel=3,
        )


def warn_unless_unit_colours(rgb: Any) -> None:
    """Warn if colours can't be RGB in [0, 1]: they are not finite, negative or far brighter.

    Args:
        rgb: (H, W, 3). An image on the device is waited for.
    """
    sample = np.asarray(rgb[::_SAMPLED, ::_SAMPLED] if isinstance(rgb, np.ndarray) else rgb)
    if not (np.abs(sample) < np.inf).all():
        warnings.warn("Some colours are not finite, but a frame's colour is RGB in [0, 1].", stacklevel=3)
    elif sample.size and not (sample.min() > -0.5 and sample.max() < _BRIGHTEST):
        warnings.warn(
            f"The colours are between {sample.min():.3g} and {sample.max():.3g}, but RGB is in [0, 1]: "
            "divide an 8-bit image by 255.",
            stacklevel=3,
        )


def _is_integer(value: Any) -> bool:
    return is_array(value) and np.dtype(value.dtype).kind in "iu"
