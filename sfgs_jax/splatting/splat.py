"""Gaussians for web viewers: the `.splat` format."""

from pathlib import Path

import numpy as np

from sfgs_jax.geometry import write_atomically
from sfgs_jax.splatting.gaussians import Gaussians, valid_arrays
from sfgs_jax.splatting.harmonics import sh_to_rgb

_RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
"""32 bytes a Gaussian, no header: metres, metres, [0, 255], and a quaternion wxyz as 128 + 128 q."""


def save_splat(path: Path | str, gaussians: Gaussians) -> None:
    """Write the valid Gaussians as a `.splat` file, which viewers in browsers stream and read.

    The Gaussians that show most come first, by opacity times volume, so that a viewer has something to
    show early. The format has eight bits for colour, opacity and rotation, and no colour that depends on the
    direction: what is written is the harmonics of degree 0. Keep a map with `save_ply`; it loses nothing.

    Raises:
        OSError: the file can't be written; what was there before is left as it was.

    Source: the format of github.com/antimatter15/splat.
    """
    values = valid_arrays(gaussians)
    scales = np.exp(values["log_scales"])
    opacities = 1 / (1 + np.exp(-values["opacity_logits"].astype(np.float64)))
    rgba = np.concatenate([sh_to_rgb(values["sh"][:, 0]), opacities[:, None]], axis=1)
    records = np.zeros(len(scales), _RECORD)
    records["position"] = values["means"]
    records["scale"] = scales
    records["rgba"] = np.clip(np.round(255 * rgba), 0, 255)
    records["rotation"] = np.clip(np.round(128 + 128 * values["quaternions"]), 0, 255)
    shown = np.log(opacities) + np.sum(values["log_scales"], axis=1)
    write_atomically(path, records[np.argsort(-shown, kind="stable")].tobytes())
