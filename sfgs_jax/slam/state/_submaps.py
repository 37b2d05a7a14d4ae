"""Submaps: Gaussians of places far from the camera, out of the map that is rendered and optimised.

Each Gaussian is held in the camera of its keyframe, so that it need not be touched when keyframes move.
"""

from dataclasses import dataclass

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.arrays import doubled, pytree
from sfgs_jax.geometry import se3
from sfgs_jax.slam.state._gaussian_map import GaussianMap, empty_map


@pytree
@dataclass(frozen=True, eq=False)
class Submap:
    """Gaussians that have left the map together; never changed.

    Attributes:
        content: the Gaussians with their optimiser, on the host; all slots are in use.
        number: how many submaps were made before it in the run.
        keyframe: number of the keyframe whose camera the box is in.
        box: (2, 3) lowest and highest coordinates of their means, metres.
    """

    content: GaussianMap
    number: int
    keyframe: int
    box: Float[np.ndarray, "2 3"]

    def __len__(self) -> int:
        """Gaussians in it."""
        return len(self.content.updates)


def without(gaussian_map: GaussianMap, chosen: Bool[np.ndarray, " n"]) -> GaussianMap:
    """The map on the device with the slots of some Gaussians free.

    Args:
        gaussian_map: before.
        chosen: (n,) slots to be free.
    """
    free = empty_map(1)
    cleared = jax.tree.map(
        lambda used, blank: np.where(chosen.reshape(-1, *(1,) * (used.ndim - 1)), np.asarray(blank), used),
        jax.tree.map(np.asarray, gaussian_map),
        free,
    )
    return jax.device_put(cleared)


def submap_of(
    gaussian_map: GaussianMap,
    chosen: Bool[np.ndarray, " n"],
    poses: Float[np.ndarray, "k 7"],
    number: int,
) -> Submap:
    """A submap of some Gaussians of a map.

    Args:
        gaussian_map: the map, on the host.
        chosen: (n,) at least one of its Gaussians.
        poses: (k, 7) `T_world_cam` of the keyframes that it agrees with, as wxyz_xyz.
        number: of the submap.
    """
    content = jax.tree.map(lambda rows: rows[chosen], gaussian_map)
    keyframe = int(content.keyframes[0])
    T = np.linalg.inv(se3.matrices_of(poses))
    means = content.gaussians.means @ T[keyframe, :3, :3].T + T[keyframe, :3, 3]
    box = np.stack([means.min(axis=0), means.max(axis=0)]).astype(np.float32)
    return Submap(_moved(content, T), number, keyframe, box)


def with_submaps(
    gaussian_map: GaussianMap, submaps: tuple[Submap, ...], poses: Float[np.ndarray, "k 7"]
) -> GaussianMap:
    """The map with the Gaussians of submaps in its free slots; its room doubles until they fit.

    Args:
        gaussian_map: before.
        submaps: to be put in.
        poses: (k, 7) `T_world_cam` of the keyframes, as wxyz_xyz.
    """
    if not submaps:
        return gaussian_map
    old = jax.tree.map(np.asarray, gaussian_map)
    capacity, used = len(old.updates), int(old.gaussians.valid.sum())
    room = doubled(capacity, used + sum(len(submap) for submap in submaps))
    blank = jax.tree.map(np.array, empty_map(room))

    def widened(wide: np.ndarray, rows: np.ndarray) -> np.ndarray:
        wide[:capacity] = rows
        return wide

    new = jax.tree.map(widened, blank, old)
    free, start, T = np.flatnonzero(~new.gaussians.valid), 0, se3.matrices_of(poses)
    for submap in submaps:
        slots = free[start : start + len(submap)]
        start += len(submap)

        def put(rows: np.ndarray, own: np.ndarray, slots: np.ndarray = slots) -> None:
            rows[slots] = own

        jax.tree.map(put, new, _moved(submap.content, T))
    return jax.device_put(new)


def _moved(content: GaussianMap, T: Float[np.ndarray, "k 4 4"]) -> GaussianMap:
    """Gaussians moved by the motion of their keyframe, on the host."""
    # Not by `se3.quaternion_product`: on the device, each size of a submap would be one more program.
    own, gaussians = T[content.keyframes], content.gaussians
    means = np.einsum("nij,nj->ni", own[:, :3, :3], gaussians.means) + own[:, :3, 3]
    a = se3.parameters_of(T)[content.keyframes, :4]
    b = np.asarray(gaussians.quaternions, np.float64)
    scalar = a[:, :1] * b[:, :1] - np.sum(a[:, 1:] * b[:, 1:], axis=1, keepdims=True)
    vector = a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])
    turned = np.concatenate([scalar, vector], axis=1)
    dtype = gaussians.means.dtype
    return eqx.tree_at(
        lambda m: (m.gaussians.means, m.gaussians.quaternions),
        content,
        (means.astype(dtype), turned.astype(dtype)),
    )
