"""Products that keep all bits of float32 on every device."""

from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

import jax

_P = ParamSpec("_P")
_R = TypeVar("_R")


def exact_products(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Decorator: matrix products traced in the function, and in functions that it calls, are exact.

    The default precision is TF32 on recent GPUs, which keeps 11 bits: poses would be off by millimetres.
    """

    @wraps(function)
    def wrapper(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        with jax.default_matmul_precision("highest"):
            return function(*args, **kwargs)

    return wrapper
