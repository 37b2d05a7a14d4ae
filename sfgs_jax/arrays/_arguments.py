"""Checks of array arguments: each error says what the argument should be, and what it is."""

from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np


def is_array(value: object) -> TypeGuard[jax.Array | np.ndarray]:
    """True for an array of JAX, traced or not, or of NumPy."""
    return isinstance(value, jax.Array | np.ndarray)


def is_floating(value: object) -> bool:
    """True for an array of float32, or of more bits."""
    return is_array(value) and jnp.issubdtype(value.dtype, jnp.floating) and value.dtype.itemsize >= 4


def described(value: Any) -> str:
    """Words for an argument in an error: an array's type and shape, or the type of anything else."""
    if is_array(value):
        return f"{value.dtype} of shape {value.shape}"
    return "None" if value is None else f"{type(value).__name__}"
