"""Capacities: sizes that arrays are padded to, so that a growing graph runs the same compiled program."""

from dataclasses import dataclass

from sfgs_jax.arrays import bucket, check_counts, doubled, rounded_up

CLUSTER_LANDMARKS = 32
"""Landmarks in a cluster: 96 rows, enough for products to run at full speed."""

CLUSTER_POSES = 20
"""Poses of a cluster, unless a landmark is seen by more."""

_SPARE = 1.25
"""Room for clusters that have all their poses before they have all their landmarks, as a factor."""

BatchSize = tuple[int, int]
"""Own and boundary poses that each front of a batch has room for."""


TRAJECTORY_FRONT: BatchSize = (24, 32)
"""Size of front that the graph of a camera's way seldom exceeds, though it crosses itself."""


@dataclass(frozen=True)
class Capacities:
    """Sizes of the arrays of a graph's structure; pass a graph's on to the next that grows from it."""

    blocks: int = 0
    """Blocks off the diagonal; 0 makes room for those of the graph and an eighth more."""

    clusters: int = 0
    """Clusters of landmarks; 0 makes room for those of the graph and an eighth more."""

    cluster_poses: int = 0
    """Poses of a cluster; 0 makes room for those of the graph and an eighth more."""

    batches: tuple[BatchSize, ...] = ()
    """Sizes of the batches of fronts of the sparse solver; empty for those of the graph."""

    least_front: BatchSize = (0, 0)
    """Size that every front has room for where `batches` is empty; doubled where that is not enough. Graphs
    of as many poses then mostly run one program, however their edges lie."""

    def __post_init__(self) -> None:
        check_counts(self, 0, "blocks", "clusters", "cluster_poses")

    @classmethod
    def for_trajectory(cls, *, edges: int) -> "Capacities":
        """Capacities of a graph of relative poses along a way, each tied to a few near it.

        Args:
            edges: most edges of the graph.
        """
        return cls(blocks=edges, least_front=TRAJECTORY_FRONT)

    @classmethod
    def for_window(cls, *, landmarks: int, poses: int) -> "Capacities":
        """Capacities of a window of fixed size, whose landmarks few of its poses see, if it has many.

        Args:
            landmarks: most landmarks of a window.
            poses: most poses of a window.
        """
        clusters = rounded_up(landmarks, CLUSTER_LANDMARKS) // CLUSTER_LANDMARKS
        if poses <= CLUSTER_POSES:
            return cls(clusters=clusters, cluster_poses=poses)
        return cls(clusters=int(_SPARE * clusters), cluster_poses=CLUSTER_POSES)


def capacity_for(count: int, given: int) -> int:
    """The given capacity, doubled until it holds `count`; without one, `count` and up to an eighth more.

    Args:
        count: rows to hold.
        given: capacity to keep to, or 0.
    """
    return doubled(given, count) if given else bucket(count, steps=8)
