"""Arrays on the host that grow by rows at their end, without a copy of all rows each time."""

import numpy as np
from jaxtyping import Shaped

from sfgs_jax.arrays._boundary import checked

_LEAST = 64
"""Rows that a new buffer has room for."""


class _Buffer(np.ndarray):
    """Memory for more rows than there are; `used` of them belong to some array."""

    used: int


@checked
def appended(
    rows: Shaped[np.ndarray, "n ..."], more: Shaped[np.ndarray, "m ..."]
) -> Shaped[np.ndarray, "k ..."]:
    """The rows of both arrays, of the type of the first.

    The new rows go behind the first array, into memory that both share, if this function made that and
    nothing was appended to it before. So n rows appended one by one copy about 3 n of them, not n² / 2. An
    array that was there before keeps its rows, whatever is appended to it. They are not to be written to, and
    one thread at a time appends.

    Args:
        rows: (n, ...) the first.
        more: (m, ...) the others.
    """
    count, total = len(rows), len(rows) + len(more)
    buffer = rows.base
    if not isinstance(buffer, _Buffer) or buffer.used != count or total > len(buffer):
        buffer = _Buffer((max(_LEAST, total + total // 2), *rows.shape[1:]), rows.dtype)
        buffer[:count] = rows
    buffer[count:total] = more
    buffer.used = total
    return np.ndarray((total, *rows.shape[1:]), rows.dtype, buffer)
