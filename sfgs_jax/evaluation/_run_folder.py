"""The folder that a run wrote, read back."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from sfgs_jax.arrays import InputError, checked, excerpt, file_text, parsed_json
from sfgs_jax.datasets import Recording, associate
from sfgs_jax.geometry import Trajectory, read_tum, twists_of
from sfgs_jax.sensors import (
    EXPOSURE_FILE,
    SENSOR_FILE,
    RollingShutter,
    read_gains,
    read_sensors,
    with_gain,
)
from sfgs_jax.splatting import BACKGROUND_FILE, read_background

SAME_TIME_S = 1e-5
"""Time stamps this close are of one frame: trajectory files hold them to the microsecond."""


@dataclass(frozen=True)
class PosedFrames:
    """The frames of a recording that have a pose in a run.

    Attributes:
        indices: positions in the recording, ascending.
        poses: `T_world_cam` of these frames, float64.
        keyframes: positions in the recording of the frames that were used for mapping.
        twists: (k, 6) motion of the camera per second in its own frame, between the neighbours of each frame.
        readout: from the first row of a colour image to its last, seconds; None if the run did not ask.
        gains: (k, 3) of each channel of these frames against the map's colours; see `sensors.fitted_gain`.
        background: colours behind the map, see `splatting.fitted_background`; None if the run has none.
    """

    indices: Int[np.ndarray, " k"]
    poses: Float[np.ndarray, "k 4 4"]
    keyframes: Int[np.ndarray, " m"]
    twists: Float[np.ndarray, "k 6"]
    readout: float | None
    gains: Float[np.ndarray, "k 3"]
    background: Float[np.ndarray, "9 3"] | None

    def shutter(self, place: int) -> RollingShutter | None:
        """The camera's motion while it exposed a frame.

        Args:
            place: of the frame in `indices`.
        """
        if self.readout is None:
            return None
        return RollingShutter(jnp.asarray(self.twists[place], jnp.float32), jnp.asarray(self.readout))

    def shown(self, place: int, rgb: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """An image of the map as the camera showed it at a frame.

        Args:
            place: of the frame in `indices`.
            rgb: colours of the map.
        """
        return with_gain(rgb, jnp.asarray(self.gains[place], jnp.float32))


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file; an empty one if there is no file. Raises InputError for anything else."""
    try:
        content = parsed_json(file_text(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {excerpt(error)}.") from error
    if not isinstance(content, dict):
        raise InputError(f"{path} holds no JSON object: it is not a file that a run wrote.")
    return content


@checked
def posed_frames(run_dir: Path, recording: Recording) -> PosedFrames:
    """Match the run's trajectory and keyframes with the recording's frames, by time stamp.

    Args:
        run_dir: folder that a run wrote.
        recording: the recording of the run.

    Raises:
        InputError: a file is missing or damaged, or none of its time stamps is one of the recording's.
    """
    trajectory = read_tum(run_dir / "trajectory.txt")
    indices, order = _frames_at(trajectory, recording)
    if len(trajectory) and not len(indices):
        raise InputError(
            f"No time stamp of {run_dir / 'trajectory.txt'} belongs to a frame of {recording.name}: "
            "the run was made on another recording."
        )
    path = run_dir / "keyframes.txt"
    keyframes = _frames_at(read_tum(path), recording)[0] if path.exists() else np.zeros(0, np.int64)
    return PosedFrames(
        indices=indices,
        poses=trajectory.poses[order],
        keyframes=keyframes,
        twists=twists_of(trajectory)[order],
        readout=_readout(run_dir / SENSOR_FILE),
        gains=_gains(run_dir / EXPOSURE_FILE, trajectory)[order],
        background=_background(run_dir / BACKGROUND_FILE),
    )


def _background(path: Path) -> Float[np.ndarray, "9 3"] | None:
    return read_background(path) if path.exists() else None


def _gains(path: Path, trajectory: Trajectory) -> Float[np.ndarray, "n 3"]:
    """Gains of the frames of a trajectory; ones if the run has estimated none."""
    if not path.exists():
        return np.ones((len(trajectory), 3))
    timestamps, gains = read_gains(path)
    if not np.array_equal(timestamps, trajectory.timestamps):
        raise InputError(f"{path} is of other frames than trajectory.txt beside it.")
    return gains


def _readout(path: Path) -> float | None:
    timing = read_sensors(path).timing if path.exists() else None
    return None if timing is None else float(timing.colour_readout)


def _frames_at(
    trajectory: Trajectory, recording: Recording
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, " k"]]:
    """Indices of the frames in the recording, ascending, and of their poses in the trajectory."""
    pairs = associate(recording.timestamps, trajectory.timestamps, SAME_TIME_S)
    return pairs[:, 0], pairs[:, 1]
