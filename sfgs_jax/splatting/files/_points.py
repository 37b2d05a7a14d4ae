"""Coloured point clouds: the Gaussians' centres, for programs that know no splats."""

from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb
from sfgs_jax.splatting.files._ply import write_vertices

_VERTEX = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]


def coloured_points(gaussians: Gaussians) -> tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]:
    """Centres of the valid Gaussians, and their mean RGB over all directions, on the host.

    Args:
        gaussians: the map.
    """
    values = valid_arrays(gaussians)
    rgb = np.clip(np.round(255 * sh_to_rgb(values["sh"][:, 0])), 0, 255)
    return values["means"], np.asarray(rgb).astype(np.uint8)


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
