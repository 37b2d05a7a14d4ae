"""glTF 2.0 in one binary file (.glb), with splats by the extension KHR_gaussian_splatting."""

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.special import expit

from sfgs_jax.arrays import InputError, write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb
from sfgs_jax.splatting.files._axes import half_turned

_EXTENSION = "KHR_gaussian_splatting"
_POINTS, _ARRAY_BUFFER, _FLOAT = 0, 34962, 5126
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def save_gltf(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians as a binary glTF file, float32.

    The axes of the file are x right, y up, z backward; rotations and harmonics turn along. Programs without
    the extension show a point cloud, whose colours are the means over all directions with the opacities, in
    linear light.

    Args:
        path: the file, `.glb` by custom; one that exists is replaced.
        gaussians: the map.

    Raises:
        InputError: there is no Gaussian, which glTF has no room for, or the file would exceed 4 GB.
        OSError: the file can't be written; an older one is left untouched.

    Source: the glTF 2.0 specification and its ratified extension KHR_gaussian_splatting.
    """
    values = half_turned(valid_arrays(gaussians))
    if not len(values["means"]):
        raise InputError("A glTF file needs at least one Gaussian.")
    attributes = _attributes(values)
    views, accessors, parts, offset = [], [], [], 0
    for name, array in attributes.items():
        content = array.tobytes()
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(content), "target": _ARRAY_BUFFER})
        accessors.append(_accessor(array, view=len(accessors), bounds=name == "POSITION"))
        parts.append(content)
        offset += len(content)
    primitive = {
        "mode": _POINTS,
        "attributes": {name: index for index, name in enumerate(attributes)},
        "extensions": {_EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    description = {
        "asset": {"version": "2.0", "generator": "sfgs_jax"},
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    write_atomically(path, _binary_gltf(description, b"".join(parts)))


def _attributes(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Attributes of the primitive by name, float32, little-endian."""
    opacities, sh = expit(values["opacity_logits"]), values["sh"]
    rgb = _linear(np.clip(sh_to_rgb(sh[:, 0]), 0, 1))
    attributes = {
        "POSITION": values["means"],
        f"{_EXTENSION}:ROTATION": np.roll(values["quaternions"], -1, axis=1),  # xyzw
        f"{_EXTENSION}:SCALE": np.exp(values["log_scales"]),
        f"{_EXTENSION}:OPACITY": opacities,
        "COLOR_0": np.concatenate([rgb, opacities[:, None]], axis=1),
    }
    first = 0
    for degree in range(math.isqrt(sh.shape[1])):
        for order in range(2 * degree + 1):
            attributes[f"{_EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = sh[:, first + order]
        first += 2 * degree + 1
    return {name: array.astype("<f4") for name, array in attributes.items()}


def _linear(rgb: np.ndarray) -> np.ndarray:
    """Linear light of sRGB colours from 0 to 1, which is what glTF wants in `COLOR_0`."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def _accessor(array: np.ndarray, *, view: int, bounds: bool) -> dict[str, object]:
    """Description of an attribute that fills a buffer view."""
    accessor: dict[str, object] = {
        "bufferView": view,
        "componentType": _FLOAT,
        "count": len(array),
        "type": _TYPES[array[0].size],
    }
    if bounds:
        accessor |= {"min": np.min(array, axis=0).tolist(), "max": np.max(array, axis=0).tolist()}
    return accessor


def _binary_gltf(description: Mapping[str, object], data: bytes) -> bytes:
    """The container: a header, then the description and the data as chunks of whole words."""
    text = json.dumps(description, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    length = 12 + 8 + len(text) + 8 + len(data)
    if length >= 2**32:
        raise InputError(f"The file would have {length / 1e9:.1f} GB; glTF ends at 4 GB. Use another format.")
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, length),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(data), b"BIN\0"),
            data,
        ]
    )
