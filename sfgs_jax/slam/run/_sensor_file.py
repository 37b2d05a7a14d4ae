"""`sensors.json`: the model of the camera that a run has found, for the next run of the same camera."""

import json
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import InputError, write_atomically
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, SensorModel, SensorTiming
from sfgs_jax.slam.frontend import estimated_timing
from sfgs_jax.slam.keyframes import estimated_depth
from sfgs_jax.slam.state import SlamState

SENSOR_FILE = "sensors.json"
_TIMES = ("depth_delay", "colour_readout", "depth_readout")


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
        found["times_s"] = dict(zip(_TIMES, np.asarray(timing.vector, float).tolist(), strict=True))
        found["times_sigma_s"] = dict(zip(_TIMES, _sigmas(covariance).tolist(), strict=True))
    depth = estimated_depth(state)
    if depth is not None:
        found["depth_offsets_per_m"] = np.asarray(depth[0].offsets, float).tolist()
        found["depth_offsets_sigma_per_m"] = _sigmas(depth[1]).reshape(DEPTH_GRID).tolist()
    if found:
        write_atomically(path, json.dumps(found, indent=2) + "\n")


def read_sensors(path: Path) -> SensorModel:
    """The model of a camera that an earlier run has written.

    Args:
        path: of its `sensors.json`.

    Raises:
        InputError: the file can't be read, or holds something else.
    """
    try:
        found = json.loads(path.read_text())
        times, offsets = found.get("times_s"), found.get("depth_offsets_per_m")
        timing = None if times is None else SensorTiming(*(float(times[name]) for name in _TIMES))
        depth = None if offsets is None else np.asarray(offsets, np.float32)
    except OSError as error:
        raise InputError(f"Cannot read the sensors in {path}: {error.strerror}.") from error
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path} holds no model of a camera: give the {SENSOR_FILE} of a run.") from error
    if timing is None and depth is None:
        raise InputError(f"{path} holds no model of a camera: give the {SENSOR_FILE} of a run.")
    if depth is not None and (depth.shape != DEPTH_GRID or not np.isfinite(depth).all()):
        rows, columns = DEPTH_GRID
        raise InputError(f"{path} needs {rows} rows of {columns} offsets of depth, all of them finite.")
    return SensorModel(timing, None if depth is None else DepthCorrection(jnp.asarray(depth)))


def _sigmas(covariance: Any) -> np.ndarray:
    return np.sqrt(np.diag(np.asarray(covariance, float)))
