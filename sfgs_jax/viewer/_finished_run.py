"""The files of a finished run, or a map by itself, for the viewer."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import FrameError, InputError, excerpt, file_text, parsed_json
from sfgs_jax.datasets import ReaderOptions, Recording, open_recording
from sfgs_jax.evaluation import PosedFrames, posed_frames
from sfgs_jax.geometry import Camera, Frame, Trajectory, read_covariances, read_tum
from sfgs_jax.sensors import RollingShutter
from sfgs_jax.splatting import Gaussians, load_map

_NOTHING = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))


class RecordedFrames:
    """The recorded images of a path's poses.

    Args:
        recording: of the run.
        posed: its frames that have a pose.
        timestamps: of the path.
    """

    def __init__(self, recording: Recording, posed: PosedFrames, timestamps: Float[np.ndarray, " n"]) -> None:
        self._recording, self._posed = recording, posed
        times = recording.timestamps[posed.indices]
        self._places = np.argmin(np.abs(timestamps[:, None] - times[None]), axis=1)

    @property
    def camera(self) -> Camera:
        """Intrinsics of the images."""
        return self._recording.camera

    def frame(self, index: int) -> Frame | None:
        """The recorded images of a pose; None if they can't be read.

        Args:
            index: position in the path.
        """
        try:
            return self._recording[int(self._posed.indices[self._places[index]])]
        except FrameError:
            return None

    def shutter(self, index: int) -> RollingShutter | None:
        """The camera's motion while it exposed a frame of the path."""
        return self._posed.shutter(int(self._places[index]))

    def shown(self, index: int, rgb: Float[Array, "H W 3"]) -> Float[Array, "H W 3"]:
        """An image of the map as the camera exposed it at a frame of the path."""
        return self._posed.shown(int(self._places[index]), rgb)


@dataclass(frozen=True)
class FinishedRun:
    """A map, and the rest of a run as far as its files are there.

    Attributes:
        name: of the folder or the file.
        gaussians: the map.
        trajectory: the path; may be empty.
        keyframes: the keyframes' poses; may be empty.
        covariances: of the path's poses; None if there are none.
        camera: intrinsics; None if they are not known.
        frames: the recorded images; None if the recording can't be opened.
        notes: why something is not there, one sentence each.
    """

    name: str
    gaussians: Gaussians
    trajectory: Trajectory = _NOTHING
    keyframes: Trajectory = _NOTHING
    covariances: Float[np.ndarray, "n 6 6"] | None = None
    camera: Camera | None = None
    frames: RecordedFrames | None = None
    notes: tuple[str, ...] = ()


def open_finished_run(path: Path) -> FinishedRun:
    """Read a run's folder, or a file of Gaussians.

    Args:
        path: folder that a run wrote, or a .ply, .splat, .spz or .glb file.

    Raises:
        InputError: there is no map, a file is damaged, or its suffix names no format.
    """
    gaussians = load_map(path)
    if path.is_file():
        return FinishedRun(path.name, gaussians)
    trajectory, keyframes = (
        read_tum(path / name) if (path / name).is_file() else _NOTHING
        for name in ("trajectory.txt", "keyframes.txt")
    )
    notes: list[str] = []
    frames = _recorded_frames(path, trajectory, notes) if len(trajectory) else None
    return FinishedRun(
        name=path.resolve().name,
        gaussians=gaussians,
        trajectory=trajectory,
        keyframes=keyframes,
        covariances=_covariances(path, trajectory),
        camera=_camera(path, notes) if frames is None else frames.camera,
        frames=frames,
        notes=tuple(notes),
    )


def _recorded_frames(path: Path, trajectory: Trajectory, notes: list[str]) -> RecordedFrames | None:
    try:
        config = _json(path / "config.json")
        if not isinstance(config.get("source"), str):
            raise InputError("config.json names no recording.")
        recording = open_recording(
            config["source"], dataset=config.get("dataset"), options=_reader_options(config.get("reader"))
        )
        return RecordedFrames(recording, posed_frames(path, recording), trajectory.timestamps)
    except InputError as error:
        notes.append(f"The recorded images are not there. {error}")
        return None


def _reader_options(found: Any) -> ReaderOptions:
    """Settings of the reader as a run wrote them; unknown ones are of another version."""
    known = {field.name for field in fields(ReaderOptions)}
    values = {name: value for name, value in (found or {}).items() if name in known}
    if values.get("camera") is not None:
        values["camera"] = Path(values["camera"])
    return ReaderOptions(**values)


def _covariances(path: Path, trajectory: Trajectory) -> Float[np.ndarray, "n 6 6"] | None:
    file = path / "trajectory_covariance.txt"
    if not file.is_file():
        return None
    times, covariances = read_covariances(file)
    return covariances if len(times) and np.array_equal(times, trajectory.timestamps) else None


def _camera(path: Path, notes: list[str]) -> Camera | None:
    """The camera that a run noted in its metrics."""
    try:
        found = _json(path / "metrics.json")["camera"]
        numbers = (float(found[name]) for name in ("fx", "fy", "cx", "cy"))
        return Camera(*numbers, width=int(found["width"]), height=int(found["height"]))
    except (InputError, KeyError, TypeError, ValueError):
        notes.append(
            "The intrinsics of the camera are not known. Frusta have the field of view of a common camera."
        )
        return None


def _json(path: Path) -> dict[str, Any]:
    try:
        content = parsed_json(file_text(path))
    except (OSError, ValueError) as error:
        raise InputError(f"Cannot read {path}: {excerpt(error)}.") from error
    return content if isinstance(content, dict) else {}
