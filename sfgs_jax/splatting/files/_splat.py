"""`.splat` files: 32-byte records that viewers in browsers stream."""

from pathlib import Path

import numpy as np
from scipy.special import expit, log_expit

from sfgs_jax.arrays import InputError, checked, excerpt, file_bytes, write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import rgb_to_sh, sh_to_rgb
from sfgs_jax.splatting.files._loaded import loaded, logits_of_bytes

_RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
"""32 bytes a Gaussian, no header: metres, metres, [0, 255], and a quaternion wxyz as 128 + 128 q."""


@checked
def save_splat(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians as a `.splat` file, which viewers in browsers stream and read.

    The most visible Gaussians come first, by opacity times volume, so that a viewer has something to show
    early. The format has eight bits for colour, opacity and rotation, and harmonics of degree 0 alone. Keep a
    map with `save_ply`, which loses nothing. The axes are the map's.

    Args:
        path: the file; one that exists is replaced.
        gaussians: the map.

    Raises:
        OSError: the file can't be written; an older one is left untouched.

    Source: the format of github.com/antimatter15/splat.
    """
    values = valid_arrays(gaussians)
    logits = values["opacity_logits"]
    rgba = np.concatenate([sh_to_rgb(values["sh"][:, 0]), expit(logits)[:, None]], axis=1)
    records = np.zeros(len(logits), _RECORD)
    records["position"] = values["means"]
    records["scale"] = np.exp(values["log_scales"])
    records["rgba"] = np.clip(np.round(255 * rgba), 0, 255)
    records["rotation"] = np.clip(np.round(128 + 128 * values["quaternions"]), 0, 255)
    visibility = log_expit(logits) + np.sum(values["log_scales"], axis=1)
    write_atomically(path, records[np.argsort(-visibility, kind="stable")].tobytes())


@checked
def load_splat(path: Path | str) -> Gaussians:
    """Read a `.splat` file; every Gaussian in it is valid, with harmonics of degree 0.

    Raises:
        InputError: the file can't be read, is cut off or empty, or has a value that is not finite.

    Source: as for `save_splat`.
    """
    path = Path(path)
    try:
        content = file_bytes(path)
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path} as a .splat file: {excerpt(error)}.") from error
    if not content or len(content) % _RECORD.itemsize:
        raise InputError(
            f"{path} is no .splat file, or cut off: it has {len(content)} bytes, and a Gaussian has "
            f"{_RECORD.itemsize}."
        )
    records = np.frombuffer(content, _RECORD)
    with np.errstate(divide="ignore", invalid="ignore"):
        log_scales = np.log(records["scale"])
    return loaded(
        path,
        means=records["position"],
        quaternions=records["rotation"].astype(np.float32) / 128 - 1,
        log_scales=log_scales,
        opacity_logits=logits_of_bytes(records["rgba"][:, 3]),
        sh=rgb_to_sh(records["rgba"][:, None, :3].astype(np.float32) / 255),
    )
