"""`sensors.json`: the model of a camera that a run has found, for the next run of the same camera."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np

from sfgs_jax.arrays import InputError, checked, excerpt, file_text, parsed_json
from sfgs_jax.sensors._depth_correction import DEPTH_GRID, DepthCorrection
from sfgs_jax.sensors._model import SensorModel
from sfgs_jax.sensors._timing import SensorTiming

SENSOR_FILE = "sensors.json"
"""Name of the file in the folder of a run."""

TIME_NAMES = ("depth_delay", "colour_readout", "depth_readout")
"""Names of the times in the file, in the order of `SensorTiming`."""

# Seconds, and 1/m. No camera is so late, and no depth so wrong.
_LARGEST = 10.0
# Metres and radians. A registration that leaves so much out is none.
_LARGEST_EXTRINSIC = 0.2


@checked
def read_sensors(path: Path) -> SensorModel:
    """The model of a camera that an earlier run has written.

    Args:
        path: of its `sensors.json`.

    Raises:
        InputError: the file can't be read, or holds something else.
    """
    try:
        found = parsed_json(file_text(path))
        times, offsets = found.get("times_s"), found.get("depth_offsets_per_m")
        tangent = found.get("T_colour_depth_tangent")
        extrinsic = None if tangent is None else np.asarray(tangent, np.float64)
        seconds = None if times is None else [float(times[name]) for name in TIME_NAMES]
        depth = None if offsets is None else np.asarray(offsets, np.float64)
    except OSError as error:
        raise InputError(f"Cannot read the sensors in {path}: {excerpt(error)}.") from error
    except (ValueError, TypeError, KeyError, AttributeError, OverflowError) as error:
        raise InputError(f"{path} holds no model of a camera: give the {SENSOR_FILE} of a run.") from error
    if seconds is None and depth is None:
        raise InputError(f"{path} holds no model of a camera: give the {SENSOR_FILE} of a run.")
    if seconds is not None and not all(abs(time) < _LARGEST for time in seconds):
        raise InputError(f"{path} needs times below {_LARGEST:g} s, all of them finite.")
    if depth is not None and (depth.shape != DEPTH_GRID or not (np.abs(depth) < _LARGEST).all()):
        rows, columns = DEPTH_GRID
        raise InputError(f"{path} needs {rows} rows of {columns} offsets of depth, all of them finite.")
    if extrinsic is not None and not (
        extrinsic.shape == (6,) and (np.abs(extrinsic) < _LARGEST_EXTRINSIC).all()
    ):
        raise InputError(
            f"{path} needs six numbers of the extrinsic, in metres and radians, below {_LARGEST_EXTRINSIC:g}."
        )
    timing = None if seconds is None else SensorTiming(*seconds)
    if depth is None:
        return SensorModel(timing)
    extrinsic = None if extrinsic is None else jnp.asarray(extrinsic, jnp.float32)
    return SensorModel(timing, DepthCorrection(jnp.asarray(depth, jnp.float32), extrinsic))
