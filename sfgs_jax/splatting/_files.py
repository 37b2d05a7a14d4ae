"""Gaussian-splat files: PLY in the layout of 3D Gaussian Splatting, and `.splat` for web viewers."""

import io
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from plyfile import PlyData, PlyElement, PlyParseError

from sfgs_jax.arrays import InputError, write_atomically
from sfgs_jax.splatting._gaussians import GAUSSIAN_PARAMETERS, Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb

_SPLAT_RECORD = np.dtype(
    [("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)]
)
"""32 bytes a Gaussian, no header: metres, metres, [0, 255], and a quaternion wxyz as 128 + 128 q."""


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
    buffer = io.BytesIO()
    PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(buffer)
    write_atomically(path, buffer.getvalue())


def load_ply(path: Path | str) -> Gaussians:
    """Read a PLY file of 3D Gaussian Splatting; every Gaussian in it is valid.

    Raises:
        InputError: the file is missing, is no PLY file, is cut off, holds something else than Gaussians
            of this layout, or has a value that is not finite.
    """
    path = Path(path)
    vertices = _read_vertices(path)
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
    gaussians = Gaussians(
        means=jnp.asarray(read("x", "y", "z")),
        quaternions=jnp.asarray(read("rot_0", "rot_1", "rot_2", "rot_3")),
        log_scales=jnp.asarray(read("scale_0", "scale_1", "scale_2")),
        opacity_logits=jnp.asarray(read("opacity")[:, 0]),
        sh=jnp.asarray(np.concatenate([base[:, None], higher.transpose(0, 2, 1)], axis=1)),
        valid=jnp.ones(len(vertices), bool),
    )
    _require_usable(path, gaussians)
    return gaussians


def save_splat(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians as a `.splat` file, which viewers in browsers stream and read.

    The most visible Gaussians come first, by opacity times volume, so that a viewer has something to show
    early. The format has eight bits for colour, opacity and rotation, and harmonics of degree 0 alone. Keep a
    map with `save_ply`, which loses nothing.

    Args:
        path: the file; one that exists is replaced.
        gaussians: the map.

    Raises:
        OSError: the file can't be written; an older one is left untouched.

    Source: the format of github.com/antimatter15/splat.
    """
    values = valid_arrays(gaussians)
    scales = np.exp(values["log_scales"])
    opacities = 1 / (1 + np.exp(-values["opacity_logits"].astype(np.float64)))
    rgba = np.concatenate([sh_to_rgb(values["sh"][:, 0]), opacities[:, None]], axis=1)
    records = np.zeros(len(scales), _SPLAT_RECORD)
    records["position"] = values["means"]
    records["scale"] = scales
    records["rgba"] = np.clip(np.round(255 * rgba), 0, 255)
    records["rotation"] = np.clip(np.round(128 + 128 * values["quaternions"]), 0, 255)
    visibility = np.log(opacities) + np.sum(values["log_scales"], axis=1)
    write_atomically(path, records[np.argsort(-visibility, kind="stable")].tobytes())


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


def _read_vertices(path: Path) -> np.ndarray:
    """The vertex element of a PLY file, as a structured array."""
    try:
        elements = PlyData.read(io.BytesIO(path.read_bytes()))
        names = {element.name for element in elements}
    except (OSError, PlyParseError, UnicodeDecodeError, ValueError) as error:
        raise InputError(f"Cannot read {path} as a PLY file: {error}.") from error
    if "vertex" not in names:
        raise InputError(f"{path} has no 'vertex' element; it is not a Gaussian splatting file.")
    return elements["vertex"].data


def _require_usable(path: Path, gaussians: Gaussians) -> None:
    """Raise InputError if a value is not finite or a quaternion is zero."""
    for name in GAUSSIAN_PARAMETERS:
        if not np.all(np.isfinite(getattr(gaussians, name))):
            raise InputError(f"{path}: {name} hold values that are not finite; the file is damaged.")
    if not np.all(np.any(np.asarray(gaussians.quaternions) != 0, axis=1)):
        raise InputError(f"{path}: a quaternion is zero; the file is damaged.")
