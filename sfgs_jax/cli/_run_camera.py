"""The camera of a run, which its recording knows."""

import math
from pathlib import Path

from sfgs_jax.arrays import InputError
from sfgs_jax.cli._configuration import read_config
from sfgs_jax.cli._log import logger
from sfgs_jax.datasets import open_recording
from sfgs_jax.geometry import Camera

DEFAULT_FIELD_OF_VIEW = 60.0
"""Horizontal field of view where nothing tells another, degrees."""

_WIDTH, _HEIGHT = 640, 480


def run_camera(path: Path, recording: str | None = None) -> Camera | None:
    """The camera of a run's recording.

    Args:
        path: folder of a run, or a file of a map.
        recording: new place of the recording; None for that of the run.

    Returns:
        The camera. None for a file; None and a line in the log, if the recording is gone or the settings are
        another version's.
    """
    if not (path / "config.json").is_file():
        return None
    try:
        config = read_config(path / "config.json")
        return open_recording(
            recording or config.source, dataset=config.dataset, options=config.reader
        ).camera
    except InputError as error:
        logger.warning("The camera of %s is not known: %s", path, error)
        return None


def camera_like(
    known: Camera | None,
    *,
    width: int | None = None,
    height: int | None = None,
    field_of_view: float | None = None,
) -> Camera:
    """A camera of a size and a horizontal field of view.

    Args:
        known: the camera to begin with; None for 640x480 pixels and 60 degrees.
        width: of the images, pixels; None takes the known camera's, or what fits the height.
        height: of the images, pixels; None takes the known camera's, or what fits the width.
        field_of_view: horizontal, degrees; None takes the known camera's. With it, pixels are square and the
            principal point is the middle.
    """
    known = known or _ideal(_WIDTH, _HEIGHT, DEFAULT_FIELD_OF_VIEW)
    if width is None and height is None:
        width, height = known.width, known.height
    elif width is None or height is None:
        aspect = known.width / known.height
        width = width or max(1, round(aspect * (height or known.height)))
        height = height or max(1, round(width / aspect))
    if field_of_view is not None:
        return _ideal(width, height, field_of_view)
    if (width, height) == (known.width, known.height):
        return known
    # Pixels lie around whole coordinates, so an image reaches from -1/2 to its size less 1/2.
    scale = width / known.width
    middle_u, middle_v = (known.width - 1) / 2, (known.height - 1) / 2
    return Camera(
        known.fx * scale,
        known.fy * scale,
        (known.cx - middle_u) * scale + (width - 1) / 2,
        (known.cy - middle_v) * scale + (height - 1) / 2,
        width=width,
        height=height,
    )


def _ideal(width: int, height: int, field_of_view: float) -> Camera:
    focal = width / 2 / math.tan(math.radians(field_of_view) / 2)
    return Camera(focal, focal, (width - 1) / 2, (height - 1) / 2, width=width, height=height)
