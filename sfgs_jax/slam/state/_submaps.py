"""Submaps: Gaussians of places far from the camera, out of the map that is rendered and optimised.

Each Gaussian is held in the camera of its keyframe, so that it need not be touched when keyframes move.
"""

from dataclasses import dataclass
from functools import partial

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Bool, Float, Int

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
    """The map with the slots of some Gaussians free. Their values stay, for all of them are finite.

    Args:
        gaussian_map: before.
        chosen: (n,) slots to be free.
    """
    valid = np.asarray(gaussian_map.gaussians.valid) & ~chosen
    return eqx.tree_at(lambda m: m.gaussians.valid, gaussian_map, jax.device_put(valid))


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
    slots = np.flatnonzero(chosen)
    content = jax.tree.map(lambda rows: rows[slots], gaussian_map)
    keyframe = int(content.keyframes[0])
    T_camera_world = np.linalg.inv(se3.matrices_of(poses[keyframe : keyframe + 1]))[0]
    means = content.gaussians.means @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    box = np.stack([means.min(axis=0), means.max(axis=0)]).astype(np.float32)
    return Submap(_moved(content, poses, to_world=False), number, keyframe, box)


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
    used, capacity = int(np.asarray(gaussian_map.gaussians.valid).sum()), len(gaussian_map.updates)
    room = doubled(capacity, used + sum(len(submap) for submap in submaps))
    new = jax.tree.map(np.array, gaussian_map if room == capacity else empty_map(room))
    if room > capacity:
        jax.tree.map(partial(_put, slice(capacity)), new, gaussian_map)
    free, start = np.flatnonzero(~new.gaussians.valid), 0
    for submap in submaps:
        slots = free[start : start + len(submap)]
        start += len(submap)
        jax.tree.map(partial(_put, slots), new, _moved(submap.content, poses, to_world=True))
    return jax.device_put(new)


def _put(at: slice | Int[np.ndarray, " m"], into: np.ndarray, rows: np.ndarray) -> None:
    into[at] = rows


def _moved(content: GaussianMap, poses: Float[np.ndarray, "k 7"], *, to_world: bool) -> GaussianMap:
    """Gaussians from the cameras of their keyframes to the world or back, on the host."""
    # Not by `se3.quaternion_product`: on the device, each size of a submap would be one more program.
    keyframes, places = np.unique(content.keyframes, return_inverse=True)
    T = se3.matrices_of(poses[keyframes])
    T = T if to_world else np.linalg.inv(T)
    own, gaussians = T[places], content.gaussians
    means = np.einsum("nij,nj->ni", own[:, :3, :3], gaussians.means) + own[:, :3, 3]
    a = se3.parameters_of(T)[places, :4]
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
