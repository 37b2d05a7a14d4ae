"""The place of a map, and its Gaussians, whatever the format of the file."""

from pathlib import Path

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting.files._contents import contents_of
from sfgs_jax.splatting.files._gltf_reader import load_gltf
from sfgs_jax.splatting.files._ply import load_ply
from sfgs_jax.splatting.files._splat import load_splat
from sfgs_jax.splatting.files._spz import load_spz

_LOADERS = {".ply": load_ply, ".splat": load_splat, ".spz": load_spz, ".glb": load_gltf}

_SUFFIXES = ", ".join(_LOADERS)


@checked
def map_file(path: Path | str) -> Path:
    """The file of a map.

    Args:
        path: folder that a run wrote, or the file itself.

    Raises:
        InputError: there is nothing at `path`, or it is a folder without a map.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"There is no {path}: give the folder that a run wrote, or a file of Gaussians.")
    if path.is_file():
        return path
    if not (path / "map.ply").is_file():
        raise InputError(
            f"{path} holds no map.ply: give the folder that a run wrote, or a file of Gaussians."
        )
    return path / "map.ply"


@checked
def load_map(path: Path | str) -> Gaussians:
    """Read the Gaussians of a run, or of a file in one of the formats that can be written.

    Args:
        path: folder that a run wrote, or a .ply, .splat, .spz or .glb file.

    Raises:
        InputError: there is no map, its suffix names no format, the file holds points or a mesh, or it is
            damaged.
    """
    file = map_file(path)
    load = _LOADERS.get(file.suffix.lower())
    if load is None:
        raise InputError(f"{file} has none of the suffixes {_SUFFIXES}; or give the folder that a run wrote.")
    if (contents := contents_of(file)) != "splats":
        held = {"points": "points", "mesh": "a mesh"}[contents]
        raise InputError(f"{file} holds {held}, no Gaussians; `sfgs-jax view` shows it.")
    return load(file)
