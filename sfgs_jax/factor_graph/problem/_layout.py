"""Layout of the normal equations: the place of every factor's blocks, found on the host, once per graph.

The reduced normal equations are a symmetric matrix of 6 x 6 blocks, stored as its upper triangle. Slot p < P
is the diagonal block of pose p. The slots after that are pairs of poses that share a factor or a landmark.

Landmarks are sorted into clusters that few poses see. Eliminating a cluster is then one dense product of a
(3 landmarks) x (6 poses) matrix with itself.
"""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Int

from sfgs_jax.arrays import rounded_up
from sfgs_jax.factor_graph.factors._factor import Factor
from sfgs_jax.factor_graph.problem._capacities import (
    CLUSTER_LANDMARKS,
    CLUSTER_POSES,
    Capacities,
    capacity_for,
)

ALL_PAIRS = 128
"""Graphs of at most this many poses keep a slot for every pair, so a new factor never needs another one."""

_UNFILLED = 4
"""Clusters with room left that a landmark is tried in, the newest first."""

_Indices = Int[Array | np.ndarray, "..."]


class Structure(eqx.Module):
    """Places of all blocks, as arrays: graphs of equal capacities share one program.

    Attributes:
        rows: (B,) first pose of each block off the diagonal; P where unused.
        columns: (B,) second pose, larger than the first.
        groups: per factor block (M, k): poses of each group of rows; P if masked.
        pose_slots: per factor block (M, k, k): slot of each pose-pose block; P + B if it is not stored.
        landmark_slots: per factor block (N,): place of its landmark among the clusters' C m; C m if masked.
        cross_slots: per factor block (N, k): place of its landmark-pose block among C m w; C m w if masked.
        cluster_poses: (C, w) poses of each cluster; P where unused.
        cluster_slots: (C, w, w) slot of each block of a cluster's product; P + B if it is not stored.
        cluster_landmarks: (C, m) landmark at each place; L where unused.
    """

    rows: _Indices
    columns: _Indices
    groups: tuple[_Indices, ...]
    pose_slots: tuple[_Indices, ...]
    landmark_slots: tuple[_Indices | None, ...]
    cross_slots: tuple[_Indices | None, ...]
    cluster_poses: _Indices
    cluster_slots: _Indices
    cluster_landmarks: _Indices


class _Clusters(NamedTuple):
    """Clusters of landmarks that few poses see.

    Attributes:
        cluster_of: (L,) cluster of each landmark, -1 for one that no pose sees.
        place_of: (L,) its place in there.
        poses_of: poses of each cluster, in order.
    """

    cluster_of: Int[np.ndarray, " L"]
    place_of: Int[np.ndarray, " L"]
    poses_of: list[list[int]]


def lay_out(factors: Sequence[Factor], num_poses: int, num_landmarks: int, given: Capacities) -> Structure:
    """Structure of a graph.

    Args:
        factors: blocks whose indices are in range.
        num_poses: P.
        num_landmarks: L.
        given: capacities to keep to while they suffice.
    """
    clusters = _cluster_landmarks(factors, num_landmarks, num_poses)
    cluster_poses = _padded_poses(clusters, num_poses, given)
    count = len(cluster_poses)
    rows, columns = _coupled_pairs(factors, cluster_poses, num_poses, given)
    slots = _PairSlots(rows, columns, num_poses)
    landmark_slots, cross_slots = _landmark_slots(factors, clusters, cluster_poses, num_poses)
    cluster_landmarks = np.full((count, CLUSTER_LANDMARKS), num_landmarks, np.int32)
    seen = np.flatnonzero(clusters.cluster_of >= 0)
    cluster_landmarks[clusters.cluster_of[seen], clusters.place_of[seen]] = seen
    return Structure(
        rows=rows,
        columns=columns,
        groups=tuple(np.where(f.group_valid[:, None], f.groups, num_poses).astype(np.int32) for f in factors),
        pose_slots=tuple(slots(f.groups[:, :, None], f.groups[:, None, :], f.group_valid) for f in factors),
        landmark_slots=landmark_slots,
        cross_slots=cross_slots,
        cluster_poses=cluster_poses,
        cluster_slots=slots(cluster_poses[:, :, None], cluster_poses[:, None, :], np.ones(count, bool)),
        cluster_landmarks=cluster_landmarks,
    )


def _tracks(factors: Sequence[Factor], num_poses: int) -> dict[int, int]:
    """Poses that see each landmark, as the bits of a number, the first pose the highest of P.

    It is 0 for a landmark whose factors have no pose.
    """
    pairs, alone = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for f in factors:
        if f.landmarks is not None:
            valid = np.asarray(f.valid)
            landmarks, poses = np.asarray(f.landmarks, np.int64)[valid], np.asarray(f.poses)[valid]
            alone.append(landmarks)
            # As single numbers they are sorted five times as fast as in two columns.
            pairs.append((landmarks[:, None] * num_poses + poses).reshape(-1))
    tracks = dict.fromkeys(np.concatenate(alone).tolist(), 0)
    sorted_pairs = np.sort(np.concatenate(pairs))
    seen, poses = np.divmod(sorted_pairs[_is_new(sorted_pairs)], num_poses)
    if not len(seen):
        return tracks
    # Numbers of Python, which have as many bits as there are poses.
    bits = np.asarray([1 << place for place in reversed(range(num_poses))], object)[poses]
    starts = np.flatnonzero(_is_new(seen))
    return tracks | dict(zip(seen[starts].tolist(), np.add.reduceat(bits, starts).tolist(), strict=True))


def _is_new(numbers: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """True for each of some numbers, none negative and in order, that differs from the one before.

    `np.unique` would hash the numbers first, which takes longer than to sort them.
    """
    return np.diff(numbers, prepend=-1) > 0


def _cluster_landmarks(factors: Sequence[Factor], num_landmarks: int, num_poses: int) -> _Clusters:
    """Greedy clustering of landmarks by the poses that see them."""
    tracks = _tracks(factors, num_poses)
    cluster_of = np.full(num_landmarks, -1, np.int64)
    place_of = np.zeros(num_landmarks, np.int64)
    limit = max(CLUSTER_POSES, max((track.bit_count() for track in tracks.values()), default=0))
    poses_of: list[int] = []
    sizes: list[int] = []
    # Where all pairs of poses have a slot, a cluster may as well hold landmarks that lie apart.
    unfilled: deque[int] = deque(maxlen=_UNFILLED if num_poses <= ALL_PAIRS else 1)
    # Tracks in order of their first poses lie together.
    for landmark in sorted(tracks, key=tracks.__getitem__, reverse=True):
        track = tracks[landmark]
        for cluster in reversed(unfilled):
            # The poses of both, counted in one instruction.
            if (poses_of[cluster] | track).bit_count() <= limit:
                break
        else:
            cluster = len(sizes)
            poses_of.append(0)
            sizes.append(0)
            unfilled.append(cluster)
        poses_of[cluster] |= track
        cluster_of[landmark], place_of[landmark] = cluster, sizes[cluster]
        sizes[cluster] += 1
        if sizes[cluster] == CLUSTER_LANDMARKS:
            unfilled.remove(cluster)
    return _Clusters(cluster_of, place_of, [_poses_in(track, num_poses) for track in poses_of])


def _poses_in(track: int, num_poses: int) -> list[int]:
    """Poses whose bits are set, in order."""
    return [pose for pose, bit in enumerate(f"{track:0{num_poses}b}") if bit == "1"]


def _padded_poses(clusters: _Clusters, num_poses: int, given: Capacities) -> Int[np.ndarray, "C w"]:
    """Poses of each cluster, padded with P."""
    if not clusters.poses_of and not given.clusters:
        return np.full((0, 0), num_poses, np.int32)
    widest = max((len(poses) for poses in clusters.poses_of), default=0)
    width = max(capacity_for(rounded_up(widest, 4), given.cluster_poses), 1)
    padded = np.full((capacity_for(len(clusters.poses_of), given.clusters), width), num_poses, np.int32)
    for c, poses in enumerate(clusters.poses_of):
        padded[c, : len(poses)] = poses
    return padded


def _landmark_slots(
    factors: Sequence[Factor], clusters: _Clusters, cluster_poses: Int[np.ndarray, "C w"], num_poses: int
) -> tuple[tuple[np.ndarray | None, ...], tuple[np.ndarray | None, ...]]:
    """Places of each factor block's landmarks, and of its landmark-pose blocks."""
    (count, width), m = cluster_poses.shape, CLUSTER_LANDMARKS
    column = np.full((count, num_poses + 1), width, np.int32)
    if count:
        np.put_along_axis(column, cluster_poses, np.arange(width, dtype=np.int32)[None], axis=1)
    landmark_slots: list[np.ndarray | None] = []
    cross_slots: list[np.ndarray | None] = []
    for f in factors:
        if f.landmarks is None:
            landmark_slots.append(None)
            cross_slots.append(None)
            continue
        valid = np.asarray(f.valid)
        landmark = np.where(valid, np.asarray(f.landmarks), 0)
        cluster = np.where(valid, clusters.cluster_of[landmark], 0)
        slot = cluster * m + clusters.place_of[landmark]
        landmark_slots.append(np.where(valid, slot, count * m).astype(np.int32))
        poses = np.where(valid[:, None], np.asarray(f.poses), 0)
        cross = slot[:, None] * width + column[cluster[:, None], poses] if count else np.zeros_like(poses)
        cross_slots.append(np.where(valid[:, None], cross, count * m * width).astype(np.int32))
    return tuple(landmark_slots), tuple(cross_slots)


def _coupled_pairs(
    factors: Sequence[Factor], cluster_poses: np.ndarray, num_poses: int, given: Capacities
) -> tuple[np.ndarray, np.ndarray]:
    """First and second pose of each block off the diagonal, in order, padded with P."""
    if num_poses <= ALL_PAIRS:
        rows, columns = np.triu_indices(num_poses, 1)
        return rows.astype(np.int32), columns.astype(np.int32)
    keys = [np.zeros(0, np.int64)]
    groups = [f.groups[f.group_valid] for f in factors]
    for group in [*groups, cluster_poses]:
        a, b = np.broadcast_arrays(group[:, :, None].astype(np.int64), group[:, None, :])
        upper = (a < b) & (b < num_poses)
        keys.append(a[upper] * num_poses + b[upper])
    found = np.unique(np.concatenate(keys))
    padding = capacity_for(len(found), given.blocks) - len(found)
    rows = np.concatenate([found // num_poses, np.full(padding, num_poses)])
    columns = np.concatenate([found % num_poses, np.full(padding, num_poses)])
    return rows.astype(np.int32), columns.astype(np.int32)


class _PairSlots:
    """Slots of pairs of poses."""

    def __init__(self, rows: np.ndarray, columns: np.ndarray, num_poses: int):
        self._num_poses = num_poses
        self._none = num_poses + len(rows)
        self._keys = rows.astype(np.int64) * (num_poses + 1) + columns

    def __call__(self, a: np.ndarray, b: np.ndarray, valid: np.ndarray) -> np.ndarray:
        a, b = np.broadcast_arrays(a.astype(np.int64), b)
        place = np.searchsorted(self._keys, a * (self._num_poses + 1) + b)
        slot = np.where(a == b, a, self._num_poses + place)
        stored = (a <= b) & (b < self._num_poses) & valid.reshape(-1, 1, 1)
        return np.where(stored, slot, self._none).astype(np.int32)
