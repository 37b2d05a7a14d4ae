"""glTF 2.0 in one binary file (.glb), with splats by the extension KHR_gaussian_splatting."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.special import expit

from sfgs_jax.arrays import InputError, checked, write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb
from sfgs_jax.splatting.files._axes import half_turned
from sfgs_jax.splatting.files._glb_container import packed_glb

EXTENSION = "KHR_gaussian_splatting"
_POINTS, _ARRAY_BUFFER, _FLOAT = 0, 34962, 5126
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


@checked
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
        "extensions": {EXTENSION: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}},
    }
    description = {
        "asset": {"version": "2.0", "generator": "sfgs_jax"},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [primitive]}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    write_atomically(path, packed_glb(description, b"".join(parts)))


def _attributes(values: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Attributes of the primitive by name, float32, little-endian."""
    opacities, sh = expit(values["opacity_logits"]), values["sh"]
    rgb = _linear(np.clip(sh_to_rgb(sh[:, 0]), 0, 1))
    attributes = {
        "POSITION": values["means"],
        f"{EXTENSION}:ROTATION": np.roll(values["quaternions"], -1, axis=1),  # xyzw
        f"{EXTENSION}:SCALE": np.exp(values["log_scales"]),
        f"{EXTENSION}:OPACITY": opacities,
        "COLOR_0": np.concatenate([rgb, opacities[:, None]], axis=1),
    }
    first = 0
    for degree in range(math.isqrt(sh.shape[1])):
        for order in range(2 * degree + 1):
            attributes[f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{order}"] = sh[:, first + order]
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
