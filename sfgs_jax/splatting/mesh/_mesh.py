"""Triangle meshes with colours, and their files."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int, UInt8
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from trimesh.visual import ColorVisuals, TextureVisuals

from sfgs_jax.arrays import InputError, checked, excerpt, require_file, write_atomically

_FARTHEST = 1e7
"""Metres. A larger number is damage."""


@dataclass(frozen=True)
class Mesh:
    """Triangles with a colour at each corner.

    Attributes:
        vertices: world coordinates, metres.
        triangles: indices of corners, counter-clockwise from the front.
        rgb: colours of the vertices in [0, 1].
    """

    vertices: Float[np.ndarray, "n 3"]
    triangles: Int[np.ndarray, "m 3"]
    rgb: Float[np.ndarray, "n 3"]


@checked
def without_small_parts(mesh: Mesh, least: int) -> Mesh:
    """The mesh without connected parts of fewer than `least` triangles, such as specks in the air."""
    count = len(mesh.vertices)
    a, b = mesh.triangles[:, [0, 1]].ravel(), mesh.triangles[:, [1, 2]].ravel()
    joined = coo_array((np.ones(len(a), bool), (a, b)), shape=(count, count))
    _, part = connected_components(joined, directed=False)
    part_of_triangle = part[mesh.triangles[:, 0]]
    large = np.bincount(part_of_triangle, minlength=1)[part_of_triangle] >= least
    triangles = mesh.triangles[large]
    used, triangles = np.unique(triangles, return_inverse=True)
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3), mesh.rgb[used])


@checked
def save_mesh(path: Path | str, mesh: Mesh) -> None:
    """Write a mesh as PLY or as binary glTF, by the suffix `.ply` or `.glb`.

    PLY has the axes of the world. glTF has x right, y up, z backward, and its colours are in linear light.

    Args:
        path: the file; one that exists is replaced.
        mesh: the mesh.

    Raises:
        InputError: the suffix is another, or the mesh has no triangle.
        OSError: the file can't be written; an older one is left untouched.
    """
    path = Path(path)
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("ply", "glb"):
        raise InputError(f"A mesh is written as .ply or .glb, not as {path.suffix or path.name}.")
    if not len(mesh.triangles):
        raise InputError(f"The mesh for {path} has no triangle: there is nothing to write.")
    glb = kind == "glb"
    surface = trimesh.Trimesh(
        vertices=mesh.vertices * ([1, -1, -1] if glb else [1, 1, 1]),
        faces=mesh.triangles,
        vertex_colors=_levels(_linear_light(mesh.rgb) if glb else mesh.rgb),
        process=False,
    )
    data = surface.export(file_type=kind)
    write_atomically(path, data if isinstance(data, bytes) else bytes(str(data), "ascii"))


@checked
def load_mesh(path: Path | str) -> Mesh:
    """Read a mesh as `save_mesh` writes it, or one of another program; without colours it is grey.

    Args:
        path: a `.ply` file in the axes of the world, or a `.glb` file with x right, y up, z backward.

    Raises:
        InputError: there is no such file, it can't be read or has no triangle, or a value is not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    try:
        require_file(path)
        read = trimesh.load(path, process=False)
        joined = read.to_mesh() if isinstance(read, trimesh.Scene) else read
    except Exception as error:  # trimesh's readers raise whatever a broken file trips
        raise InputError(f"Cannot read a mesh from {path}: {excerpt(error)}.") from error
    if not isinstance(joined, trimesh.Trimesh) or not len(joined.faces):
        raise InputError(f"{path} has no triangle: it is no mesh.")
    vertices, triangles = np.asarray(joined.vertices, np.float64), np.asarray(joined.faces, np.int64)
    if vertices.shape[1] != 3:
        raise InputError(f"{path} has corners of {vertices.shape[1]} coordinates, not 3: it is damaged.")
    if not np.all(np.abs(vertices) < _FARTHEST) or triangles.min() < 0 or triangles.max() >= len(vertices):
        raise InputError(f"{path} has a corner that is not finite, too far away or not there: it is damaged.")
    glb = path.suffix.lower() == ".glb"
    visual = joined.visual
    textured = isinstance(visual, TextureVisuals)
    colours = visual.to_color() if textured else visual
    if not isinstance(colours, ColorVisuals):
        raise InputError(f"{path} has colours of an unknown kind.")
    rgb = np.asarray(colours.vertex_colors, np.float64)[:, :3] / 255
    # Colours of textures are no linear light.
    rgb = _srgb(rgb) if glb and not textured else rgb
    return Mesh(vertices * ([1, -1, -1] if glb else [1, 1, 1]), triangles, rgb)


def _levels(rgb: Float[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 3"]:
    return np.round(255 * np.clip(rgb, 0, 1)).astype(np.uint8)


def _linear_light(rgb: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Intensities of sRGB values."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((np.maximum(rgb, 0) + 0.055) / 1.055) ** 2.4)


def _srgb(light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    """Values in sRGB of intensities from 0 to 1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
