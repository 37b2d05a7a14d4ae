"""The surface at distance zero of a volume, by marching cubes.

Source: Lewiner et al., Efficient implementation of marching cubes' cases with topological guarantees, 2003,
as scikit-image computes it.
"""

import itertools
from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Float32, Int

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.splatting.mesh._mesh import Mesh
from sfgs_jax.splatting.mesh._tsdf_volume import SIDE, Place, TsdfVolume, packed_rows

_STEPS_PER_VOXEL = 512
"""Vertices of two bricks are one if they agree to a voxel divided by this."""


@checked
def zero_surface(volume: TsdfVolume, *, least_weight: float = 0.0) -> Mesh:
    """The surface that a volume has seen, as triangles with colours.

    Args:
        volume: the volume.
        least_weight: for a surface in a cube the weights of all corners must be greater. An image that is
            faced counts 1, one that is seen from the side less.

    Raises:
        InputError: scikit-image is missing.
    """
    parts = [
        part
        for place in sorted(volume.bricks)
        if (part := _of_brick(volume, place, least_weight)) is not None
    ]
    if not parts:
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int64), np.zeros((0, 3)))
    starts = np.cumsum([0, *(len(vertices) for vertices, _, _ in parts[:-1])])
    return _joined(
        np.concatenate([vertices for vertices, _, _ in parts]),
        np.concatenate([triangles + start for (_, triangles, _), start in zip(parts, starts, strict=True)]),
        np.concatenate([rgb for _, _, rgb in parts]),
        volume.voxel,
    )


def _of_brick(
    volume: TsdfVolume, place: Place, least_weight: float
) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, "m 3"], Float32[np.ndarray, "n 3"]] | None:
    """Vertices in voxels, triangles and colours of the cubes of a brick; None where there is no surface."""
    distance = _with_neighbours(volume, place, "distance")
    if not (distance.min() < 0 < distance.max()):
        return None
    seen = _with_neighbours(volume, place, "weight") > least_weight
    corners = [slice(0, SIDE), slice(1, SIDE + 1)]
    whole = np.ones((SIDE, SIDE, SIDE), bool)
    for corner in itertools.product(corners, repeat=3):
        whole &= seen[corner]
    if not np.any(whole):
        return None
    # The mask of scikit-image is looked up at the last corner of a cube.
    mask = np.zeros_like(seen)
    mask[1:, 1:, 1:] = whole
    try:
        vertices, triangles, _, _ = _marching_cubes()(distance, 0.0, mask=mask, allow_degenerate=False)
    except RuntimeError:
        return None  # none of the cubes in the mask has a surface
    return vertices + np.asarray(place) * SIDE, triangles, _colours(volume, place, vertices)


def _marching_cubes() -> Callable[..., tuple]:
    """The function of scikit-image, an optional dependency."""
    try:
        from skimage.measure import marching_cubes
    except ImportError as error:
        raise InputError("Meshes need scikit-image: pip install 'sfgs-jax[mesh]'.") from error
    return marching_cubes


def _with_neighbours(volume: TsdfVolume, place: Place, name: str) -> Float32[np.ndarray, "17 17 17 *c"]:
    """Values of a brick and of the first layer of those that follow it; zero where there is none."""
    own = getattr(volume.bricks[place], name)
    values = np.zeros((SIDE + 1,) * 3 + own.shape[3:], np.float32)
    for step in itertools.product((0, 1), repeat=3):
        brick = volume.bricks.get((place[0] + step[0], place[1] + step[1], place[2] + step[2]))
        if brick is not None:
            to = tuple(slice(SIDE, SIDE + 1) if one else slice(0, SIDE) for one in step)
            of = tuple(slice(0, 1) if one else slice(0, SIDE) for one in step)
            values[to] = getattr(brick, name)[of]
    return values


def _colours(
    volume: TsdfVolume, place: Place, vertices: Float32[np.ndarray, "n 3"]
) -> Float32[np.ndarray, "n 3"]:
    """Colours of vertices, between those of the two voxels beside each."""
    rgb, weights = (_with_neighbours(volume, place, name) for name in ("rgb", "rgb_weight"))
    low, high = np.floor(vertices).astype(int), np.ceil(vertices).astype(int)
    part = np.clip(np.sum(vertices - low, axis=1), 0, 1)
    ends = [(low, 1 - part), (high, part)]
    total, weight = np.zeros_like(vertices), np.zeros(len(vertices), np.float32)
    for end, share in ends:
        at = tuple(end.T)
        # An end without a colour leaves it to the other.
        own = (share + np.float32(1e-3)) * (weights[at] > 0)
        total += own[:, None] * rgb[at]
        weight += own
    return total / np.maximum(weight, np.float32(1e-6))[:, None]


def _joined(
    vertices: Float[np.ndarray, "n 3"],
    triangles: Int[np.ndarray, "m 3"],
    rgb: Float[np.ndarray, "n 3"],
    voxel: float,
) -> Mesh:
    """The mesh of the parts; vertices that bricks share become one."""
    index = packed_rows(np.rint(vertices * _STEPS_PER_VOXEL).astype(np.int64))
    _, first, own = np.unique(index, return_index=True, return_inverse=True)
    triangles = own[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    return Mesh(
        np.asarray(vertices[first], np.float64) * voxel, triangles, np.asarray(rgb[first], np.float64)
    )
