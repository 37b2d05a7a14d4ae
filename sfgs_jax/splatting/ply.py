"""Gaussians in files: the PLY layout of 3D Gaussian Splatting, which every viewer reads."""

import io
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from plyfile import PlyData, PlyElement, PlyParseError

from sfgs_jax.geometry import InputError, write_atomically
from sfgs_jax.splatting.gaussians import Gaussians, valid_arrays


def _columns(coefficients: int) -> list[str]:
    """Names of the properties in their order; `coefficients` are per colour channel."""
    return [
        *("x", "y", "z", "nx", "ny", "nz"),
        *(f"f_dc_{i}" for i in range(3)),
        *(f"f_rest_{i}" for i in range(3 * (coefficients - 1))),
        "opacity",
        *(f"scale_{i}" for i in range(3)),
        *(f"rot_{i}" for i in range(4)),
    ]


def save_ply(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians: binary, little-endian, float32.

    The layout is that of 3D Gaussian Splatting: opacity before the sigmoid, logarithms of the scales,
    quaternions wxyz (written with unit length), harmonics above degree 0 channel by channel, zero normals.

    Raises:
        OSError: the file can't be written; what was there before is left as it was.
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
    rows = np.ascontiguousarray(table).view([(name, "<f4") for name in _columns(k)])[:, 0]
    buffer = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(buffer)
    write_atomically(path, buffer.getvalue())


def load_ply(path: Path | str) -> Gaussians:
    """Read a PLY file of 3D Gaussian Splatting; every Gaussian in it is valid.

    Raises:
        InputError: there is no such file, it is no PLY file or cut off, it holds something else than
            Gaussians of this layout, or a value is not finite.
    """
    path = Path(path)
    try:
        elements = PlyData.read(io.BytesIO(path.read_bytes()))
        names = {element.name for element in elements}
    except (OSError, PlyParseError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"Cannot read {path} as a PLY file: {error}.") from error
    if "vertex" not in names:
        raise InputError(f"{path} has no 'vertex' element; it is not a Gaussian splatting file.")
    vertices = elements["vertex"].data
    rest = sum(name.startswith("f_rest_") for name in vertices.dtype.names)
    coefficients = rest // 3 + 1
    missing = [name for name in _columns(coefficients) if name not in vertices.dtype.names and name[0] != "n"]
    if missing:
        raise InputError(
            f"{path} is not a Gaussian splatting file: it has no {', '.join(missing[:3])}; "
            "export it in the layout of 3D Gaussian Splatting."
        )
    if rest != 3 * (coefficients - 1) or coefficients not in (1, 4, 9, 16):
        raise InputError(f"{path} has {rest} f_rest properties; degrees 0 to 3 have 0, 9, 24 or 45.")

    def read(*names: str) -> np.ndarray:
        columns = [np.asarray(vertices[name], np.float32) for name in names]
        return np.stack(columns, axis=1) if columns else np.zeros((len(vertices), 0), np.float32)

    base = read("f_dc_0", "f_dc_1", "f_dc_2")
    higher = read(*(f"f_rest_{i}" for i in range(rest))).reshape(len(vertices), 3, coefficients - 1)
    values = {
        "means": read("x", "y", "z"),
        "quaternions": read("rot_0", "rot_1", "rot_2", "rot_3"),
        "log_scales": read("scale_0", "scale_1", "scale_2"),
        "opacity_logits": read("opacity")[:, 0],
        "sh": np.concatenate([base[:, None], higher.transpose(0, 2, 1)], axis=1),
    }
    for name, value in values.items():
        if not np.all(np.isfinite(value)):
            raise InputError(f"{path}: {name} hold values that are not finite; the file is damaged.")
    if not np.all(np.any(values["quaternions"] != 0, axis=1)):
        raise InputError(f"{path}: a quaternion is zero; the file is damaged.")
    return Gaussians(
        **{name: jnp.asarray(value) for name, value in values.items()},
        valid=jnp.ones(len(vertices), bool),
    )
