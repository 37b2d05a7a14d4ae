"""Writing of `sensors.json`, the model of the camera that a run has found."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from sfgs_jax.arrays import write_atomically
from sfgs_jax.sensors import DEPTH_GRID, TIME_NAMES
from sfgs_jax.slam.frontend import estimated_timing
from sfgs_jax.slam.keyframes import estimated_depth
from sfgs_jax.slam.state import SlamState


def write_sensors(state: SlamState, path: Path) -> None:
    """Write what the run has found; nothing where it estimated nothing.

    Args:
        state: after the run.
        path: of the file.

    Raises:
        OSError: the file can't be written.
    """
    found: dict[str, Any] = {}
    if state.config.tracking.estimate_timing:
        timing, covariance = estimated_timing(state.params, state.tracker)
        found["times_s"] = dict(zip(TIME_NAMES, timing.on_host().astype(float).tolist(), strict=True))
        found["times_sigma_s"] = dict(zip(TIME_NAMES, _sigmas(covariance).tolist(), strict=True))
    depth = estimated_depth(state)
    if depth is not None:
        sigmas = _sigmas(depth[1])
        found["depth_offsets_per_m"] = np.asarray(depth[0].offsets, float).tolist()
        found["depth_offsets_sigma_per_m"] = sigmas[:-6].reshape(DEPTH_GRID).tolist()
        if depth[0].extrinsic is not None:
            found["T_colour_depth_tangent"] = np.asarray(depth[0].extrinsic, float).tolist()
            found["T_colour_depth_sigma"] = sigmas[-6:].tolist()
    if found:
        write_atomically(path, json.dumps(found, indent=2) + "\n")


def _sigmas(covariance: Any) -> np.ndarray:
    return np.sqrt(np.diag(np.asarray(covariance, float)))
