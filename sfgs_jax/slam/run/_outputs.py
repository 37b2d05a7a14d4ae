"""The folder a run writes: trajectory, keyframes, map, metrics, configuration."""

import contextlib
import json
import platform
import resource
import shutil
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path

import jax
import numpy as np

from sfgs_jax.arrays import InputError, checked, make_folder, remove_unfinished, sync_folder, write_atomically
from sfgs_jax.geometry import Camera, format_covariances, format_tum
from sfgs_jax.sensors import EXPOSURE_FILE, SENSOR_FILE, format_gains
from sfgs_jax.slam.run._driver import Run
from sfgs_jax.slam.run._sensor_file import write_sensors
from sfgs_jax.slam.run._storage import STATE_FILE
from sfgs_jax.splatting import BACKGROUND_FILE, format_background, save_ply

COVARIANCE_FILE = "trajectory_covariance.txt"
OUTPUT_FILES = (
    "trajectory.txt",
    COVARIANCE_FILE,
    "keyframes.txt",
    "map.ply",
    "metrics.json",
    "config.json",
    SENSOR_FILE,
    EXPOSURE_FILE,
    BACKGROUND_FILE,
    "frames.csv",
    "report.html",
    "run.log",
)
"""Everything a run writes, estimates of its camera where it made them; --overwrite replaces all of it."""


GROUND_TRUTH_FILE = "groundtruth.txt"
"""Poses that the recording knows, beside the run's own; written where there are any."""

STORAGE = "state"
"""Folder within the run's own, for what it goes on from after a stop; removed at its end, unless kept."""


@checked
def prepare_folder(folder: Path, *, overwrite: bool) -> None:
    """Make the output folder and make sure, before any work is done, that it can be written.

    Args:
        folder: where the run will write.
        overwrite: whether an earlier run's files there may be replaced; other files are left alone.

    Raises:
        InputError: it is not empty, not a folder, or can't be written.
    """
    try:
        make_folder(folder)
        present = sorted(path.name for path in folder.iterdir())
        if present and not overwrite:
            raise InputError(
                f"The output folder {folder} is not empty (it holds {present[0]}): choose another with "
                "--out, or pass --overwrite to replace an earlier run."
            )
        remove_unfinished(folder, *OUTPUT_FILES, GROUND_TRUTH_FILE)
        for name in (*OUTPUT_FILES, GROUND_TRUTH_FILE):
            (folder / name).unlink(missing_ok=True)
        for path in (*_files_of_maps(folder, from_number=2), *folder.glob("*_recording_[0-9]*.txt")):
            path.unlink(missing_ok=True)
        # A view of an earlier run would be taken for one of this run.
        _remove_storage(folder / STORAGE)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0")
    except OSError as error:
        raise InputError(
            f"The output folder {folder} cannot be written ({error.strerror}): choose another with --out."
        ) from error


@checked
def resume_folder(folder: Path) -> Path:
    """The folder's storage, for `load_run`; temporary files of a run that was killed are removed.

    Args:
        folder: of the run that was stopped.

    Raises:
        InputError: it holds nothing to go on from, or can't be written.
    """
    storage = folder / STORAGE
    if folder.is_dir() and not (storage / STATE_FILE).exists() and (folder / "metrics.json").exists():
        raise InputError(
            f"{folder} holds no run that could be resumed: it has ended. --overwrite starts it again."
        )
    if not storage.is_dir():
        raise InputError(
            f"{folder} holds no run that could be resumed: it has ended, or was stopped before its first "
            "checkpoint; --overwrite starts it again."
        )
    try:
        remove_unfinished(folder, *OUTPUT_FILES, GROUND_TRUTH_FILE)
        remove_unfinished(storage, "*.safetensors")
    except OSError as error:
        raise InputError(f"The output folder {folder} cannot be written ({error.strerror}).") from error
    return storage


@checked
def kept_map(folder: Path) -> Path:
    """The storage of a run that was kept at its end, for `load_run` and another recording.

    Args:
        folder: of the run.

    Raises:
        InputError: it holds none.
    """
    storage = folder / STORAGE
    if not (storage / STATE_FILE).exists():
        raise InputError(
            f"{folder} holds no map that a run could go on in: run its recording with --keep-map first."
        )
    return storage


@checked
def remove_storage(folder: Path) -> None:
    """Remove what a run that has come to its end could go on from; whatever can't be removed stays.

    Args:
        folder: of the run.
    """
    with contextlib.suppress(OSError):
        _remove_storage(folder / STORAGE)


def _remove_storage(storage: Path) -> None:
    """Remove the state first, for without its images it would be taken for a damaged one."""
    if storage.is_dir():
        (storage / STATE_FILE).unlink(missing_ok=True)
        sync_folder(storage)
        shutil.rmtree(storage)


@checked
def write_run(run: Run, folder: Path) -> None:
    """Write the paths, the estimates of camera and background, `metrics.json` and `map.ply`, in this order.

    Raises:
        OSError: a file can't be written, for instance because the disk is full; those before it are whole.
    """
    write_trajectories(run, folder)
    largest, *others = run.maps
    own = largest.recordings[0]
    if own.gains is not None:
        gains = format_gains(own.trajectory.timestamps, own.gains)
        write_atomically(folder / EXPOSURE_FILE, gains)
    background = own.background
    if background is not None:
        write_atomically(folder / BACKGROUND_FILE, format_background(background))
    write_sensors(run.state, folder / SENSOR_FILE)
    write_atomically(folder / "metrics.json", json.dumps(run_metrics(run), indent=2) + "\n")
    save_ply(folder / "map.ply", largest.gaussians)
    for number, other in enumerate(others, start=2):
        save_ply(folder / f"map_{number}.ply", other.gaussians)


@checked
def write_trajectories(run: Run, folder: Path) -> None:
    """Write the paths and the covariances; cheap enough to be done again and again during a run.

    The files are of the largest map. The others have a `trajectory_N.txt` each, from N = 2 on.

    After a merge these files hold the frames of the first recording, the one that the settings name. The
    frames of another are in `trajectory_recording_N.txt`, and those that the map was made from in
    `keyframes_recording_N.txt`, from N = 2 on. They are in the same world, by their own times.
    """
    largest, *others = run.maps
    own, *joined = largest.recordings
    found = own.trajectory
    write_atomically(folder / "trajectory.txt", format_tum(found))
    write_atomically(folder / COVARIANCE_FILE, format_covariances(found.timestamps, own.covariances))
    write_atomically(folder / "keyframes.txt", format_tum(own.keyframe_trajectory))
    for number, part in enumerate(joined, start=2):
        write_atomically(folder / f"trajectory_recording_{number}.txt", format_tum(part.trajectory))
        write_atomically(folder / f"keyframes_recording_{number}.txt", format_tum(part.keyframe_trajectory))
    for number, other in enumerate(others, start=2):
        write_atomically(folder / f"trajectory_{number}.txt", format_tum(other.trajectory))
    # Maps that were written at an earlier call may have become one since.
    for path in _files_of_maps(folder, from_number=len(others) + 2):
        path.unlink(missing_ok=True)


def _files_of_maps(folder: Path, *, from_number: int) -> list[Path]:
    """Files of the maps from this number on."""
    found = (*folder.glob("trajectory_[0-9]*.txt"), *folder.glob("map_[0-9]*.ply"))
    numbers = {path: path.stem.rpartition("_")[2] for path in found}
    return [path for path, number in numbers.items() if number.isdecimal() and int(number) >= from_number]


def run_metrics(run: Run) -> dict[str, object]:
    """Counts, times and memory of a run; the evaluation adds metrics that need ground truth or images."""
    stages = run.stopwatch.summary()
    maps = run.maps
    gaussians = maps[0].gaussians
    used = int(np.asarray(gaussians.valid).sum())
    slots = gaussians.valid.shape[0]
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(gaussians)) // slots * used
    tracking = run.stopwatch.total("tracking")
    state = run.state
    tracked, all_tracked = len(maps[0].rows), len(state.log.timestamps)
    return {
        "frames": {
            "total": run.num_frames,
            "tracked": tracked,
            "skipped": run.num_skipped,
            "dropped": run.num_dropped,
            "in_other_maps": all_tracked - tracked,
            "lost": state.num_lost,
            "keyframes": len(state.graph.keyframes),
            "views": len(state.mapping.views),
            "interrupted": run.interrupted,
        },
        "fps": {
            "tracking": round(1e3 / stages["tracking"]["median_ms"], 2) if tracking else 0.0,
            "frames": round(_rate(stages["frame"]), 2) if tracking else 0.0,
            "overall": round(run.num_frames / run.stopwatch.elapsed, 2),
        },
        "stages": stages,
        "camera": _numbers_of(state.camera),
        "map": {
            "number": len(maps),
            "gaussians": used,
            "bytes": size,
            "dropped": state.mapping.dropped_seeds,
            "views": len(state.mapping.views),
            "steps": state.mapping.num_steps,
        },
        "memory": {"peak_mb": round(peak_memory_mb(), 1)},
        "loops": {"accepted": len(state.graph.loops)},
        "versions": versions(),
    }


def _numbers_of(camera: Camera) -> dict[str, float]:
    """Intrinsics by the names of a camera.json: the images, freed of lens distortion, are of this camera."""
    focal = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    return {**focal, "width": camera.width, "height": camera.height}


def _rate(stage: dict[str, float]) -> float:
    """Rate of a stage per second; the first time is left out where there are others."""
    if stage["count"] == 1:
        return 1e3 / stage["first_ms"]
    return (stage["count"] - 1) / (stage["total_s"] - stage["first_ms"] / 1e3)


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, MiB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    packages = ("sfgs-jax", "jax", "jaxlib", "numpy", "opencv-python-headless")
    return {name: version(name) for name in packages} | {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "device": jax.devices()[0].device_kind,
    }
