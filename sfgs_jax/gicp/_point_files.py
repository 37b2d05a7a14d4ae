"""Points from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError


def load_points(path: Path | str) -> Float[np.ndarray, "N 3"]:
    """Points of a point cloud, or vertices of a mesh, in any format that trimesh reads; float64 metres.

    Raises:
        InputError: there is no such file, or it has no points that trimesh can read.
    """
    # Imported here, because only this function needs it and it takes long.
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    try:
        loaded = trimesh.load(path)
    except Exception as error:  # trimesh's readers raise whatever a broken file trips
        raise InputError(f"Cannot read points from {path}: {error}.") from error
    parts = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
    kinds = trimesh.PointCloud, trimesh.Trimesh
    vertices = [np.asarray(part.vertices, np.float64) for part in parts if isinstance(part, kinds)]
    points = np.concatenate(vertices) if vertices else np.zeros((0, 3))
    if not len(points):
        raise InputError(f"{path} holds no points; give a point cloud such as a PLY file.")
    return points
