"""Sizes that arrays are padded to, so that a graph that grows runs the program already compiled."""

from dataclasses import dataclass

BatchSize = tuple[int, int]
"""Own and boundary poses that each front of a batch has room for."""


@dataclass(frozen=True)
class Capacities:
    """Sizes of the arrays that a structure is padded to; pass a graph's on to the next that grows from it."""

    blocks: int = 0
    """Blocks off the diagonal."""

    clusters: int = 0
    """Clusters of landmarks."""

    cluster_poses: int = 0
    """Poses of a cluster."""

    batches: tuple[BatchSize, ...] = ()
    """Sizes of the batches of fronts of the sparse solver's plan."""


def capacity_for(count: int, given: int) -> int:
    """What is given if that is enough, else doubled until it is; with nothing given, an eighth of room."""
    if given == 0:
        step = max(1, 2 ** (max(count, 1).bit_length() - 4))
        return -(-count // step) * step
    while given < count:
        given *= 2
    return given
