"""`.splat` files: 32-byte records that viewers in browsers stream."""

from pathlib import Path

import numpy as np
from scipy.special import expit, log_expit

from sfgs_jax.arrays import write_atomically
from sfgs_jax.splatting._gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting._spherical_harmonics import sh_to_rgb

_RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
"""32 bytes a Gaussian, no header: metres, metres, [0, 255], and a quaternion wxyz as 128 + 128 q."""


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
