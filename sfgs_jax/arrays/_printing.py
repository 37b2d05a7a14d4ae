"""Results as text: numbers in a few digits, anything else by its type and shape."""

from enum import Enum
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer


class Text(str):
    """Text that is printed as it is, without quotes."""

    __slots__ = ()


def is_known(value: object) -> bool:
    """True for an array that is not traced, and for all that is no array."""
    return not isinstance(value, Tracer)


def printed(value: Any, unit: str = "", digits: int = 4) -> str:
    """A number with its unit, the name of an enumeration's member, the type and shape of anything else.

    Args:
        value: anything; arrays may be traced or batched.
        unit: follows a number.
        digits: significant digits of a number with a fraction.
    """
    if isinstance(value, Text):
        return str(value)
    if isinstance(value, Enum):
        return value.name
    if not is_known(value) or not isinstance(value, jax.Array | np.ndarray | np.generic | bool | int | float):
        return eqx.tree_pformat(value)
    number = np.asarray(value)
    if number.shape != ():
        return eqx.tree_pformat(value)
    text = f"{number[()]:.{digits}g}" if number.dtype.kind == "f" else str(number[()])
    return f"{text} {unit}" if unit else text


def printed_fields(name: str, **fields: Any) -> str:
    """Text of a result, `Name(field=value, ...)`.

    Args:
        name: of its class.
        fields: values; a tuple is a value with its unit.
    """
    pairs = {key: value if isinstance(value, tuple) else (value,) for key, value in fields.items()}
    return f"{name}({', '.join(f'{key}={printed(*value)}' for key, value in pairs.items())})"


def printed_count(used: Any) -> str:
    """Count of the slots of a mask in use, `12 of 16`; the type and shape of a traced or batched mask."""
    if not is_known(used) or not isinstance(used, jax.Array | np.ndarray) or used.ndim != 1:
        return eqx.tree_pformat(used)
    return f"{int(np.sum(np.asarray(used)))} of {used.shape[0]}"


def printed_length(values: Any) -> str:
    """Number of elements; anything that has none is printed as it is."""
    return str(len(values)) if hasattr(values, "__len__") else printed(values)
