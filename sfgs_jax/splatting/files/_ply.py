"""PLY files in the layout of 3D Gaussian Splatting."""

import io
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float
from plyfile import PlyData, PlyElement

from sfgs_jax.arrays import InputError, checked, excerpt, require_file, write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting.files._loaded import loaded

_LONGEST_HEADER = 65536
"""Bytes. A header names some 60 properties."""


@checked
def save_ply(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians as a binary PLY file, little-endian, float32.

    The layout is that of 3D Gaussian Splatting. Opacities are written before the sigmoid, scales as
    logarithms, quaternions wxyz with unit length. Harmonics above degree 0 go channel by channel; normals
    are zero.

    Args:
        path: the file; one that exists is replaced.
        gaussians: the map.

    Raises:
        OSError: the file can't be written; an older one is left untouched.
    """
    values = valid_arrays(gaussians)
    sh = values["sh"]
    n, k = sh.shape[:2]
    table = np.concatenate(
        [
            values["means"],
            np.zeros((n, 3), np.float32),
            sh[:, 0],
            sh[:, 1:].transpose(0, 2, 1).reshape(n, 3 * (k - 1)),
            values["opacity_logits"][:, None],
            values["log_scales"],
            values["quaternions"],
        ],
        axis=1,
    )
    rows = np.ascontiguousarray(table).view([(name, "<f4") for name in _ply_columns(k)])[:, 0]
    write_vertices(path, rows)


def write_vertices(path: Path | str, rows: np.ndarray) -> None:
    """Write a binary PLY file of vertices, whole or not at all.

    Args:
        path: the file; one that exists is replaced.
        rows: structured array with a field for each property.

    Raises:
        OSError: the file can't be written.
    """
    buffer = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(buffer)
    write_atomically(path, buffer.getvalue())


@checked
def load_ply(path: Path | str) -> Gaussians:
    """Read a PLY file of 3D Gaussian Splatting; every Gaussian in it is valid.

    Raises:
        InputError: the file is missing, is no PLY file, is cut off, holds something else than Gaussians
            of this layout, or has a value that is not finite.
    """
    path = Path(path)
    vertices = read_vertices(path)
    names = vertices.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    coefficients = rest // 3 + 1
    missing = [name for name in _ply_columns(coefficients) if name not in names and name[0] != "n"]
    if missing:
        raise InputError(
            f"{path} is not a Gaussian splatting file: it has no {', '.join(missing[:3])}; "
            "export it in the layout of 3D Gaussian Splatting."
        )
    if rest != 3 * (coefficients - 1) or coefficients not in (1, 4, 9, 16):
        raise InputError(f"{path} has {rest} f_rest properties; degrees 0 to 3 have 0, 9, 24 or 45.")

    def read(*columns: str) -> Float[np.ndarray, "n c"]:
        values = [np.asarray(vertices[name], np.float32) for name in columns]
        return np.stack(values, axis=1) if values else np.zeros((len(vertices), 0), np.float32)

    base = read("f_dc_0", "f_dc_1", "f_dc_2")
    higher = read(*(f"f_rest_{i}" for i in range(rest))).reshape(len(vertices), 3, coefficients - 1)
    return loaded(
        path,
        means=read("x", "y", "z"),
        quaternions=read("rot_0", "rot_1", "rot_2", "rot_3"),
        log_scales=read("scale_0", "scale_1", "scale_2"),
        opacity_logits=read("opacity")[:, 0],
        sh=np.concatenate([base[:, None], higher.transpose(0, 2, 1)], axis=1),
    )


def _ply_columns(coefficients: int) -> list[str]:
    """Names of the properties in their order, with so many coefficients per colour channel."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(3 * (coefficients - 1))),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def read_vertices(path: Path) -> np.ndarray:
    """The vertex element of a PLY file, as a structured array.

    Args:
        path: the file.

    Raises:
        InputError: the file is missing, is no PLY file, is cut off, or has no vertices.
    """
    try:
        _require_rows(path)
        # plyfile maps a real file into memory. From a stream it reads number by number.
        with path.open("rb") as file:
            elements = PlyData.read(file)
        names = {element.name for element in elements}
    except Exception as error:  # plyfile raises whatever a broken header trips
        raise InputError(f"Cannot read {path} as a PLY file: {excerpt(error)}.") from error
    if "vertex" not in names:
        raise InputError(f"{path} has no 'vertex' element: it holds neither Gaussians nor points.")
    vertices = elements["vertex"].data
    _require_end(elements, path)
    return vertices


def _require_end(elements: PlyData, path: Path) -> None:
    """Raise InputError if a binary file has more rows than its header says."""
    rows = [element.data for element in elements]
    if elements.text or any(row.dtype.hasobject for row in rows):
        return
    header = len(_header(path)) + len(b"end_header\n")
    rest = path.stat().st_size - header - sum(row.nbytes for row in rows)
    if rows and rest >= rows[-1].dtype.itemsize:
        raise InputError(f"{path} has {rest} bytes more than its header says; the file is damaged.")


def _require_rows(path: Path) -> None:
    """Raise ValueError if a header promises more rows than there are bytes, before room is made for them."""
    size = require_file(path)
    rows = sum(map(int, re.findall(rb"^element \S+ (\d+)", _header(path), re.MULTILINE)))
    if rows > size:
        raise ValueError(f"it should have {excerpt(rows)} rows and has {size} bytes")


def _header(path: Path) -> bytes:
    """The beginning of a file, up to the end of its header. Raises ValueError if it has none."""
    with path.open("rb") as file:
        head, end, _ = file.read(_LONGEST_HEADER).partition(b"end_header")
    if not head.startswith(b"ply") or not end:
        raise ValueError("it has no header")
    return head
