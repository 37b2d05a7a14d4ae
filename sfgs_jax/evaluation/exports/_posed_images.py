"""The images of a run's frames as files: colour, and depth in millimetres."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, Shaped

from sfgs_jax.arrays import FrameError, InputError, write_atomically
from sfgs_jax.datasets import Recording
from sfgs_jax.datasets.files import depth_units
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.geometry import Frame

UNITS_PER_METRE = 1000.0
"""Units of depth images; 16 bits reach 65 m."""


def posed_images(
    recording: Recording, posed: PosedFrames
) -> Iterator[tuple[str, Frame, Float[np.ndarray, "4 4"]]]:
    """Name, frame and `T_world_cam` of the frames that have a pose; those that can't be decoded are left out.

    Args:
        recording: the recording of the run.
        posed: its frames with a pose.
    """
    for index, pose in zip(posed.indices.tolist(), posed.poses, strict=True):
        try:
            yield f"frame_{index:06d}.png", recording[index], pose
        except FrameError:
            continue


def encoded_colour(frame: Frame, suffix: str = ".png") -> bytes:
    """The colour image as the bytes of a file.

    Args:
        frame: a frame.
        suffix: names the format.
    """
    rgb = np.round(np.asarray(frame.rgb) * 255).astype(np.uint8)
    return _encoded(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), suffix)


def written_images(
    path: Path, recording: Recording, posed: PosedFrames
) -> Iterator[tuple[str, Frame, Float[np.ndarray, "4 4"]]]:
    """`posed_images`, each written before it is given: colour to `images`, depth in millimetres to `depth`.

    Args:
        path: folder, made if it is not there.
        recording: the recording of the run.
        posed: its frames with a pose.

    Raises:
        InputError: the folder holds something already, or can't be made.
        OSError: a file can't be written.
    """
    _make_empty_folder(path)
    for kind in ("images", "depth"):
        (path / kind).mkdir()
    for name, frame, pose in posed_images(recording, posed):
        units = depth_units(np.asarray(frame.depth), UNITS_PER_METRE)
        write_atomically(path / "images" / name, encoded_colour(frame), sync_name=False)
        write_atomically(path / "depth" / name, _encoded(units, ".png"), sync_name=False)
        yield name, frame, pose


def _make_empty_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise InputError(f"{path} is not empty; give a new folder.")
    except OSError as error:
        raise InputError(f"The folder {path} can't be made ({error.strerror}).") from error


def _encoded(image: Shaped[np.ndarray, "h w *c"], suffix: str) -> bytes:
    ok, data = cv2.imencode(suffix, image)
    if not ok:
        raise InputError(f"Cannot encode an image as {suffix}.")
    return data.tobytes()
