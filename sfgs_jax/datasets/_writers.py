"""Writers of recordings as files, in layouts that the readers know."""

import json
from pathlib import Path
from typing import Literal, assert_never

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from sfgs_jax.arrays import InputError, checked, excerpt, write_atomically
from sfgs_jax.datasets._recording import Recording
from sfgs_jax.datasets.files import depth_units
from sfgs_jax.geometry import Camera, Frame, Trajectory, format_tum

Layout = Literal["tum", "replica", "folder"]

_UNITS_PER_METRE = {"tum": 5000.0, "replica": 6553.5, "folder": 1000.0}
_JPEG_QUALITY = 98


@checked
def write_recording(recording: Recording, path: str | Path, *, layout: Layout) -> None:
    """Write all frames of a recording, and its ground truth if it has any.

    Depth is rounded to the layout's 16-bit steps: TUM 0.2 mm, Replica 0.15 mm, folder 1 mm. Depth beyond
    their range (13 m, 10 m, 65 m) becomes missing. Colour is PNG with 8 bits, in Replica JPEG. Replica
    has no time stamps: its reader takes 30 frames a second. TUM and folder carry a camera.json.

    Args:
        recording: source; its frames must all be readable.
        path: folder to write to; made if it isn't there, and must be empty.
        layout: layout of the files.

    Raises:
        InputError: the folder isn't empty or can't be written.
        FrameError: a frame can't be used.
    """
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"{path} is not empty; give a new folder.")
        match layout:
            case "tum":
                _write_tum(recording, path)
            case "replica":
                _write_replica(recording, path)
            case "folder":
                _write_folder(recording, path)
            case _:
                assert_never(layout)
    except OSError as error:
        raise InputError(f"Cannot write to {path}: {excerpt(error)}.") from error


def _write_tum(recording: Recording, path: Path) -> None:
    lists = {"rgb": "# timestamp filename\n", "depth": "# timestamp filename\n"}
    for kind in lists:
        (path / kind).mkdir()
    for index, time in enumerate(recording.timestamps.tolist()):
        frame = recording[index]
        # A depth image whose time is not known counts as taken with its colour image.
        depth_time = time if frame.depth_timestamp is None else frame.depth_timestamp
        colour, depth = f"rgb/{time:.6f}.png", f"depth/{depth_time:.6f}.png"
        _write_pair(frame, path, colour, depth, "tum")
        lists["rgb"] += f"{time:.6f} {colour}\n"
        lists["depth"] += f"{depth_time:.6f} {depth}\n"
    for kind, text in lists.items():
        write_atomically(path / f"{kind}.txt", text)
    _write_camera(recording.camera, path, "tum")
    if recording.ground_truth is not None:
        write_atomically(path / "groundtruth.txt", format_tum(recording.ground_truth))


def _write_replica(recording: Recording, path: Path) -> None:
    numbers = range(len(recording))
    colour = [f"results/frame{n:06d}.jpg" for n in numbers]
    depth = [f"results/depth{n:06d}.png" for n in numbers]
    _write_images(recording, path, colour, depth, "replica")
    camera = recording.camera
    content = {
        "camera": {
            "w": camera.width,
            "h": camera.height,
            "fx": float(camera.fx),
            "fy": float(camera.fy),
            "cx": float(camera.cx),
            "cy": float(camera.cy),
            "scale": _UNITS_PER_METRE["replica"],
        }
    }
    write_atomically(path / "cam_params.json", json.dumps(content, indent=2) + "\n")
    if recording.ground_truth is not None:
        write_atomically(path / "traj.txt", _matrix_rows(recording.ground_truth, recording.timestamps))


def _write_folder(recording: Recording, path: Path) -> None:
    names = [f"{timestamp:.6f}" for timestamp in recording.timestamps]
    colour, depth = ([f"{kind}/{name}.png" for name in names] for kind in ("rgb", "depth"))
    _write_images(recording, path, colour, depth, "folder")
    _write_camera(recording.camera, path, "folder")
    if recording.ground_truth is not None:
        write_atomically(path / "poses.txt", _matrix_rows(recording.ground_truth, recording.timestamps))


def _write_images(
    recording: Recording, path: Path, colour_names: list[str], depth_names: list[str], layout: Layout
) -> None:
    for name in {Path(name).parent for name in (*colour_names, *depth_names)}:
        (path / name).mkdir(exist_ok=True)
    for index, (colour_name, depth_name) in enumerate(zip(colour_names, depth_names, strict=True)):
        _write_pair(recording[index], path, colour_name, depth_name, layout)


def _write_pair(frame: Frame, path: Path, colour_name: str, depth_name: str, layout: Layout) -> None:
    rgb = np.round(np.asarray(frame.rgb) * 255).astype(np.uint8)
    _write_image(path / colour_name, cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR))
    _write_image(path / depth_name, depth_units(np.asarray(frame.depth), _UNITS_PER_METRE[layout]))


def _write_image(path: Path, image: Shaped[np.ndarray, "h w *channels"]) -> None:
    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if path.suffix == ".jpg" else []
    ok, data = cv2.imencode(path.suffix, image, options)
    if not ok:
        raise InputError(f"Cannot encode {path}.")
    write_atomically(path, data.tobytes(), sync_name=False)


def _write_camera(camera: Camera, path: Path, layout: Layout) -> None:
    content = {
        "fx": float(camera.fx),
        "fy": float(camera.fy),
        "cx": float(camera.cx),
        "cy": float(camera.cy),
        "width": camera.width,
        "height": camera.height,
        "depth_scale": _UNITS_PER_METRE[layout],
    }
    write_atomically(path / "camera.json", json.dumps(content, indent=2) + "\n")


def _matrix_rows(trajectory: Trajectory, timestamps: Float[np.ndarray, " n"]) -> str:
    """One line of 16 numbers a frame; frames without a pose get `nan`."""
    poses = np.full((len(timestamps), 4, 4), np.nan)
    poses[np.searchsorted(timestamps, trajectory.timestamps)] = trajectory.poses
    return "".join(" ".join(f"{value:.12g}" for value in pose.ravel()) + "\n" for pose in poses)
