"""Points from files."""

from pathlib import Path

import numpy as np
import trimesh

from sfgs_jax.geometry import InputError


def load_points(path: Path | str) -> np.ndarray:
    """(N, 3) float64 points, metres, of a point cloud or a mesh's vertices in any format that trimesh reads.

    Raises:
        InputError: there is no such file, or it has no points that trimesh can read.
    """
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
