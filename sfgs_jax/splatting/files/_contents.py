"""Whether a file holds Gaussians, points or a mesh."""

import re
from pathlib import Path
from typing import Literal

from sfgs_jax.arrays import checked
from sfgs_jax.splatting.files._glb_container import unpacked_glb
from sfgs_jax.splatting.files._gltf_reader import splat_primitives

Contents = Literal["splats", "points", "mesh"]

_LONGEST_HEADER = 65536


@checked
def contents_of(path: Path | str) -> Contents:
    """What a file holds, by its head. Files that can't be told are left to the reader of splats.

    A PLY file of points has places alone, or colours with them; one with any property of a Gaussian counts as
    splats.

    Args:
        path: an existing file.

    Raises:
        InputError: a .glb file is damaged.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".glb":
        description, _ = unpacked_glb(path)
        # Also meshes of other programs may be compressed: trimesh tells what it can read.
        return "splats" if splat_primitives(description) else "mesh"
    if suffix != ".ply":
        return "splats"
    with path.open("rb") as file:
        head, end, _ = file.read(_LONGEST_HEADER).partition(b"end_header")
    names = set(re.findall(rb"^property +\w+ +(\w+)\r?$", head, re.MULTILINE))
    if not end or not {b"x", b"y", b"z"} <= names or names & {b"f_dc_0", b"opacity", b"scale_0", b"rot_0"}:
        return "splats"
    faces = re.search(rb"^element +face +(\d+)", head, re.MULTILINE)
    return "mesh" if faces and faces[1].strip(b"0") else "points"
