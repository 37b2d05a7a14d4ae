"""Which pose of one trajectory belongs to which of another, by time."""

import numpy as np
from jaxtyping import Float, Int


def associate(
    timestamps_a: Float[np.ndarray, " n"],
    timestamps_b: Float[np.ndarray, " m"],
    *,
    max_difference_s: float = 0.02,
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Pair time stamps one to one, the closest pairs first.

    Args:
        timestamps_a: (n,) seconds, in any order.
        timestamps_b: (m,) seconds, in any order.
        max_difference_s: pairs further apart than this are not made; exactly as far is allowed.

    Returns:
        Indices into `timestamps_a` and into `timestamps_b`, (k,) each, in the order of time.
    """
    order_a, order_b = np.argsort(timestamps_a, kind="stable"), np.argsort(timestamps_b, kind="stable")
    times_a, times_b = timestamps_a[order_a], timestamps_b[order_b]
    first = np.searchsorted(times_b, times_a - max_difference_s, side="left")
    last = np.searchsorted(times_b, times_a + max_difference_s, side="right")
    counts = last - first
    a = np.repeat(np.arange(len(times_a)), counts)
    b = np.repeat(first - (np.cumsum(counts) - counts), counts) + np.arange(counts.sum())
    free_a, free_b = np.ones(len(times_a), bool), np.ones(len(times_b), bool)
    pairs = []
    for candidate in np.argsort(np.abs(times_a[a] - times_b[b]), kind="stable"):
        i, j = a[candidate], b[candidate]
        if free_a[i] and free_b[j]:
            free_a[i] = free_b[j] = False
            pairs.append((i, j))
    table = np.asarray(sorted(pairs), np.int64).reshape(-1, 2)
    return order_a[table[:, 0]], order_b[table[:, 1]]
