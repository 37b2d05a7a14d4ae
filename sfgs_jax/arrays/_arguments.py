"""Checks of array arguments: each error says what the argument should be, and what it is."""

from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays._errors import InputError


def is_array(value: object) -> TypeGuard[jax.Array | np.ndarray]:
    """True for an array of JAX, traced or not, or of NumPy."""
    return isinstance(value, jax.Array | np.ndarray)


def is_floating(value: object) -> bool:
    """True for an array of float32, or of more bits."""
    return is_array(value) and jnp.issubdtype(value.dtype, jnp.floating) and value.dtype.itemsize >= 4


def require_least(value: Any, least: int, name: str) -> None:
    """Refuse a number that is too small; one on the device is not waited for.

    Args:
        value: the argument.
        least: the smallest that it may be.
        name: of it and of its function.

    Raises:
        InputError: it is smaller.
    """
    if isinstance(value, int | float | np.number) and not value >= least:
        raise InputError(f"{name} should be at least {least}, not {value}.")


def require_above_zero(value: Any, name: str) -> None:
    """Refuse a number that is not above 0; one on the device is not waited for.

    Args:
        value: the argument.
        name: of it and of its function.

    Raises:
        InputError: it is 0 or below.
    """
    if isinstance(value, int | float | np.number) and not value > 0:
        raise InputError(f"{name} should be above 0, not {value}.")


def described(value: Any) -> str:
    """Words for an argument in an error: an array's type and shape, or the type of anything else."""
    if is_array(value):
        return f"{value.dtype} of shape {value.shape}"
    return "None" if value is None else f"{type(value).__name__}"
