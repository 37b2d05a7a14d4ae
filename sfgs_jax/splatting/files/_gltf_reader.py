"""Gaussians from binary glTF files with the extension KHR_gaussian_splatting."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import logit

from sfgs_jax.arrays import InputError, checked
from sfgs_jax.splatting._gaussians import Gaussians
from sfgs_jax.splatting.files._axes import half_turned
from sfgs_jax.splatting.files._glb_container import unpacked_glb
from sfgs_jax.splatting.files._gltf import EXTENSION
from sfgs_jax.splatting.files._loaded import loaded

_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_KINDS = {5126: ("<f4", 1), 5121: ("u1", 255), 5123: ("<u2", 65535), 5120: ("i1", 127), 5122: ("<i2", 32767)}
"""NumPy's types of glTF's components, and the divisor of normalised ones."""

_NEAREST_TO_ONE = 1e-6
"""Opacities of exactly 0 and 1 have no finite logit."""


@checked
def load_gltf(path: Path | str) -> Gaussians:
    """Read the Gaussians of a binary glTF file; every one is valid, in axes with y down and z forward.

    All primitives with the extension KHR_gaussian_splatting are read. Transforms of nodes are not applied.

    Args:
        path: the file, such as `save_gltf` writes.

    Raises:
        InputError: the file is missing, is no binary glTF, holds no Gaussians, has transforms or compressed
            attributes, or is damaged.
    """
    path = Path(path)
    description, data = unpacked_glb(path)
    found = splat_primitives(description)
    if not found:
        raise InputError(f"{path} holds no Gaussians: none of its primitives has the extension {EXTENSION}.")
    if any(key in node for node in _dicts(description, "nodes") for key in _TRANSFORMS):
        raise InputError(f"{path} moves its Gaussians by a node's transform, which is not supported.")
    try:
        parts = [_values(primitive, description, data) for primitive in found]
        joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise InputError(f"{path}: the attributes of the Gaussians are damaged or compressed.") from error
    values = half_turned(joined)
    return loaded(
        path,
        means=values["means"],
        quaternions=values["quaternions"],
        log_scales=values["log_scales"],
        opacity_logits=values["opacity_logits"],
        sh=values["sh"],
    )


_TRANSFORMS = ("matrix", "translation", "rotation", "scale")


def splat_primitives(description: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Primitives that are Gaussians.

    Args:
        description: of a glTF file.
    """
    return [
        primitive
        for mesh in _dicts(description, "meshes")
        for primitive in _dicts(mesh, "primitives")
        if isinstance(primitive.get("extensions"), dict) and EXTENSION in primitive["extensions"]
    ]


def _dicts(parent: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """The entries of a list that are objects; a damaged file may hold anything."""
    found = parent.get(name)
    return [entry for entry in found if isinstance(entry, dict)] if isinstance(found, Sequence) else []


def _values(
    primitive: Mapping[str, Any], description: Mapping[str, Any], data: bytes
) -> dict[str, Float[np.ndarray, "n ..."]]:
    """Arrays of one primitive by the names of `GAUSSIAN_PARAMETERS`, still in the file's axes."""
    attributes = primitive["attributes"]

    def read(name: str, kind: str = "VEC3") -> Float[np.ndarray, "n k"]:
        accessor = description["accessors"][attributes[name]]
        if accessor["type"] != kind:
            raise ValueError(f"{name} is no {kind}.")
        return _accessor(accessor, description, data)

    count = sum(name.startswith(f"{EXTENSION}:SH_DEGREE_") for name in attributes)
    degrees = math.isqrt(count)
    if degrees * degrees != count or not 1 <= degrees <= 4:
        raise ValueError(f"{count} coefficients are no whole degrees.")
    names = [f"SH_DEGREE_{d}_COEF_{n}" for d in range(degrees) for n in range(2 * d + 1)]
    scales = read(f"{EXTENSION}:SCALE")
    opacities = np.clip(read(f"{EXTENSION}:OPACITY", "SCALAR")[:, 0], _NEAREST_TO_ONE, 1 - _NEAREST_TO_ONE)
    return {
        "means": read("POSITION"),
        "quaternions": np.roll(read(f"{EXTENSION}:ROTATION", "VEC4"), 1, axis=1),  # wxyz
        "log_scales": np.log(np.maximum(scales, np.finfo(np.float32).tiny)),
        "opacity_logits": logit(opacities),
        "sh": np.stack([read(f"{EXTENSION}:{name}") for name in names], axis=1),
    }


def _accessor(
    accessor: Mapping[str, Any], description: Mapping[str, Any], data: bytes
) -> Float[np.ndarray, "n k"]:
    """The values of an accessor in float64, normalised integers as what they stand for."""
    view = description["bufferViews"][accessor["bufferView"]]
    if view["buffer"] != 0 or "sparse" in accessor:
        raise ValueError("The data are elsewhere.")
    kind, divisor = _KINDS[accessor["componentType"]]
    width, count = _WIDTHS[accessor["type"]], accessor["count"]
    item = np.dtype(kind).itemsize * width
    stride = view.get("byteStride", item)
    first = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    if count < 1 or stride < item or first < 0 or first + (count - 1) * stride + item > len(data):
        raise ValueError("The data end before the accessor does.")
    rows = np.ndarray((count, width), kind, data, first, (stride, np.dtype(kind).itemsize))
    with np.errstate(invalid="ignore"):  # a NaN may signal; whoever reads the values refuses it
        values = rows.astype(np.float64)
    return np.maximum(values / divisor, -1) if divisor > 1 else values
