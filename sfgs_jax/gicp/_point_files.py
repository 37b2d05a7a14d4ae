"""Points from files."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, checked, excerpt, file_bytes, parsed_json

# Metres. A larger number is damage.
_FARTHEST = 1e9
_ARCHIVES = (".zip", ".gz", ".bz2")
_GLB_DESCRIPTION = slice(12, 20)
"""Length and kind of the first chunk of a binary glTF; the chunk itself follows."""


@checked
def load_points(path: Path | str) -> Float[np.ndarray, "N 3"]:
    """Points of a point cloud, or vertices of a mesh, in any format that trimesh reads; float64 metres.

    Raises:
        InputError: there is no such file, it is an archive, it has no points that trimesh can read, or one
            that is not finite.
    """
    # Imported here, because only this function needs it and it takes long.
    import trimesh

    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    if path.suffix.lower() in _ARCHIVES:
        raise InputError(f"{path} is an archive; unpack it first.")
    try:
        content = file_bytes(path)
        beside = _files_beside(path, content)
        loaded = trimesh.load(io.BytesIO(content), file_type=path.suffix[1:].lower(), resolver=beside)
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


def _files_beside(path: Path, content: bytes) -> dict[str, bytes] | None:
    """The files in which a glTF has its data, by name; those that other formats name hold no points.

    Raises:
        OSError, ValueError: one can't be read, or numbers have no place in any. trimesh makes room for such
            ones however many there are.
    """
    suffix = path.suffix.lower()
    if suffix == ".glb":
        length = int.from_bytes(content[_GLB_DESCRIPTION][:4], "little")
        content = content[_GLB_DESCRIPTION.stop :][:length]
    elif suffix != ".gltf":
        return None
    description: Any = parsed_json(content)
    if not all("bufferView" in accessor for accessor in description.get("accessors", ())):
        raise ValueError("it has numbers without data")
    names = [buffer.get("uri", "") for buffer in description.get("buffers", ())]
    return {
        name: file_bytes(path.parent / Path(name).name) for name in names if name[:5] not in ("", "data:")
    }
