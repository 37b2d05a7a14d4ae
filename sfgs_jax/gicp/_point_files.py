"""Points from files."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, excerpt, require_file

# Metres. A larger number is damage.
_FARTHEST = 1e9


@checked
def load_points(path: Path | str) -> Float[np.ndarray, "N 3"]:
    """Points of a point cloud, or vertices of a mesh, in any format that trimesh reads; float64 metres.

    Raises:
        InputError: there is no such file, it has no points that trimesh can read, or one that is not finite.
    """
    # Imported here, because only this function needs it and it takes long.
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    try:
        require_file(path)
        loaded = trimesh.load(path)
    except Exception as error:  # trimesh's readers raise whatever a broken file trips
        raise InputError(f"Cannot read points from {path}: {excerpt(error)}.") from error
    parts = loaded.geometry.values() if isinstance(loaded, trimesh.Scene) else [loaded]
    kinds = trimesh.PointCloud, trimesh.Trimesh
    vertices = [np.asarray(part.vertices, np.float64) for part in parts if isinstance(part, kinds)]
    if not all(part.ndim == 2 and part.shape[1] == 3 for part in vertices):
        raise InputError(f"{path} has points that are not three numbers each; the file is damaged.")
    points = np.concatenate(vertices) if vertices else np.zeros((0, 3))
    if not len(points):
        raise InputError(f"{path} holds no points; give a point cloud such as a PLY file.")
    if not (np.abs(points) < _FARTHEST).all():
        raise InputError(f"{path} has a point that is not finite or beyond 10^9 m; the file is damaged.")
    return points
