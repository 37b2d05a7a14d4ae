"""Arguments of factors: their types, and the check that every array has one row for each factor."""

from collections.abc import Sequence
from typing import get_args

import numpy as np
from jaxtyping import ArrayLike, Bool, Float, Int, Shaped

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Kernel

Indices = Int[ArrayLike, " N"] | Sequence[int]
"""(N,) indices of poses or landmarks, known on the host."""

IndexPairs = Int[ArrayLike, "N 2"] | Sequence[Sequence[int]]
"""(N, 2) indices of two poses, known on the host."""

Mask = Bool[ArrayLike, " N"] | Sequence[bool]
"""(N,) rows that count, known on the host."""

Scalar = Float[ArrayLike, ""]
"""A number."""

PerRow = Float[ArrayLike, ""] | Float[ArrayLike, " N"]
"""A number for each row, or one for all of them."""


def as_indices(kind: str, name: str, given: Shaped[ArrayLike, "..."] | Sequence) -> Int[np.ndarray, "..."]:
    """Indices as an array on the host.

    Args:
        kind: of the factor, for the message.
        name: of the argument, for the message.
        given: integers.

    Raises:
        InputError: numbers that are not integers.
    """
    indices = np.asarray(given)
    if indices.size and indices.dtype.kind not in "iu":
        raise InputError(f"{kind} needs {name} as integers, but they are {indices.dtype}.")
    return indices.astype(np.int32)


def check_shape(
    kind: str, name: str, given: Shaped[ArrayLike, "..."] | Sequence, *allowed: tuple[int, ...]
) -> None:
    """Refuse an array of any other than the allowed shapes.

    Args:
        kind: of the factor, for the message.
        name: of the argument, for the message.
        given: the array; it may be traced.
        allowed: its possible shapes.

    Raises:
        InputError: the array has another shape.
    """
    shape = np.shape(given)
    if shape not in allowed:
        wanted = " or ".join(str(shape) for shape in allowed)
        raise InputError(f"{kind} needs {name} of shape {wanted}, but the shape is {shape}.")


def check_kernel(kind: str, kernel: str) -> None:
    """Refuse a robust kernel of an unknown name."""
    if kernel not in get_args(Kernel):
        raise InputError(f"{kind} has no kernel {kernel!r}; choose one of {', '.join(get_args(Kernel))}.")
