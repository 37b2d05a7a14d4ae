"""The place of a map: a PLY file, or the folder of a run."""

from pathlib import Path

from sfgs_jax.arrays import InputError


def map_file(path: Path | str) -> Path:
    """The PLY file of a map.

    Args:
        path: folder that a run wrote, or the file itself.

    Raises:
        InputError: there is nothing at `path`, or it is a folder without a map.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"There is no {path}: give the folder that a run wrote, or a .ply file.")
    if path.is_file():
        return path
    if not (path / "map.ply").is_file():
        raise InputError(f"{path} holds no map.ply: give the folder that a run wrote, or a .ply file.")
    return path / "map.ply"
