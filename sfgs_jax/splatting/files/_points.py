"""Coloured point clouds: the Gaussians' centres, for programs that know no splats."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb
from sfgs_jax.splatting.files._ply import read_vertices, write_vertices

_FARTHEST = 1e7
"""Metres. A larger number is damage."""

_VERTEX = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]


@checked
def coloured_points(gaussians: Gaussians) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Centres of the valid Gaussians, and their mean RGB over all directions, on the host.

    Args:
        gaussians: the map.
    """
    values = valid_arrays(gaussians)
    rgb = np.clip(np.round(255 * sh_to_rgb(values["sh"][:, 0])), 0, 255)
    return values["means"], np.asarray(rgb).astype(np.uint8)


@checked
def save_points(path: Path | str, gaussians: Gaussians) -> None:
    """Write the centres of the valid Gaussians as a binary PLY point cloud with RGB.

    A point's colour is the mean of its Gaussian over all directions. The axes are the map's, in metres.

    Args:
        path: the file; one that exists is replaced.
        gaussians: the map.

    Raises:
        OSError: the file can't be written; an older one is left untouched.
    """
    centres, rgb = coloured_points(gaussians)
    vertices = np.zeros(len(rgb), _VERTEX)
    for column, name in enumerate("xyz"):
        vertices[name] = centres[:, column]
    for column, name in enumerate(("red", "green", "blue")):
        vertices[name] = rgb[:, column]
    write_vertices(path, vertices)


@checked
def load_coloured_points(
    path: Path | str,
) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Read a PLY point cloud as `save_points` writes it: places in metres, and RGB; grey if it has none.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing, damaged or no PLY file, or has no points or one that is not finite.
    """
    path = Path(path)
    vertices = read_vertices(path)
    names = vertices.dtype.names or ()
    if not len(vertices) or not {"x", "y", "z"} <= set(names):
        raise InputError(f"{path} holds no points.")
    with np.errstate(invalid="ignore"):  # damaged numbers are refused below
        places = np.stack([np.asarray(vertices[name], np.float64) for name in "xyz"], axis=1)
    if not np.all(np.abs(places) < _FARTHEST):
        raise InputError(f"{path} has a point that is not finite or beyond {_FARTHEST:g} m.")
    channels = ("red", "green", "blue")
    if not all(name in names and vertices[name].dtype == np.uint8 for name in channels):
        return places, np.full(places.shape, 128, np.uint8)
    return places, np.stack([vertices[name] for name in channels], axis=1)
