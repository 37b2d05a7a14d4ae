"""`sensors.json`: the model of a camera that a run has found, for the next run of the same camera."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import InputError
from sfgs_jax.sensors._depth_correction import DEPTH_GRID, DepthCorrection
from sfgs_jax.sensors._model import SensorModel
from sfgs_jax.sensors._timing import SensorTiming

SENSOR_FILE = "sensors.json"
"""Name of the file in the folder of a run."""

TIME_NAMES = ("depth_delay", "colour_readout", "depth_readout")
"""Names of the times in the file, in the order of `SensorTiming`."""


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
        timing = None if times is None else SensorTiming(*(float(times[name]) for name in TIME_NAMES))
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
