"""Figures of single frames, their means by protocol, and the table of both for other programs."""

import csv
import io
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import InputError, excerpt, file_text
from sfgs_jax.evaluation.images._image_metrics import PROTOCOLS, Protocol

FRAMES_FILE = "frames.csv"
"""Name of the table in the folder of a run."""

_COLUMNS = (
    *("index", "timestamp", "view", "position_error_m"),
    *(f"{kind}_{name}" for kind in ("psnr", "ssim") for name in PROTOCOLS),
    *("lpips_squeeze", "depth_l1_m", "coverage", "gain_r", "gain_g", "gain_b"),
)


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one frame.

    Attributes:
        index: position in the recording.
        timestamp: seconds.
        view: whether the frame was used for mapping.
        psnr: dB, by the protocols that the frame belongs to.
        ssim: by the same.
        depth_l1_m: mean distance along z of the map from the recorded depth, metres; NaN without any.
        coverage: mean accumulated opacity of the map over the pixels that hold an image.
        lpips: of the protocol `LPIPS_PROTOCOL`; None if it was not computed.
    """

    index: int
    timestamp: float
    view: bool
    psnr: dict[Protocol, float]
    ssim: dict[Protocol, float]
    depth_l1_m: float
    coverage: float
    lpips: float | None


def mean_by_protocol(figures: Iterable[dict[Protocol, float]]) -> dict[Protocol, float]:
    """Means over frames, of the protocols that any of them belongs to.

    Args:
        figures: PSNR or SSIM of each frame.
    """
    values: dict[Protocol, list[float]] = {name: [] for name in PROTOCOLS}
    for figure in figures:
        for name, value in figure.items():
            values[name].append(value)
    return {name: float(np.mean(found)) for name, found in values.items() if found}


def format_frames(
    frames: list[FrameFigures],
    position_errors_m: dict[int, float],
    gains: dict[int, Float[np.ndarray, "3"]],
) -> str:
    """A table in CSV, a line a frame; what is not known is left empty.

    Args:
        frames: the figures.
        position_errors_m: distance from the ground truth, of the frames that have one, by their index.
        gains: of each channel against the map, by the index of the frame.
    """
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(_COLUMNS)
    for frame in frames:
        error, lpips = position_errors_m.get(frame.index, np.nan), frame.lpips
        numbers = [by.get(name, np.nan) for by in (frame.psnr, frame.ssim) for name in PROTOCOLS]
        numbers += [np.nan if lpips is None else lpips, frame.depth_l1_m, frame.coverage]
        numbers += gains[frame.index].tolist()
        start = [frame.index, f"{frame.timestamp:.6f}", int(frame.view), _number(error)]
        table.writerow(start + [_number(number) for number in numbers])
    return text.getvalue()


def read_frames(path: Path) -> dict[str, Float[np.ndarray, " n"]]:
    """The columns of a table that `format_frames` wrote, NaN where nothing is known; none without a file.

    Args:
        path: of the file.

    Raises:
        InputError: the file holds something else.
    """
    if not path.exists():
        return {}
    try:
        names, *rows = csv.reader(file_text(path).splitlines())
        if missing := set(_COLUMNS).difference(names):
            raise ValueError(f"it lacks the column {min(missing)}")
        table = np.asarray([[float(cell or "nan") for cell in row] for row in rows]).reshape(-1, len(names))
    except (OSError, ValueError, csv.Error) as error:
        raise InputError(f"Cannot read the figures of frames in {path}: {excerpt(error)}.") from error
    if np.isinf(table).any():
        raise InputError(f"The figures of frames in {path} are infinite; the file is damaged.")
    return dict(zip(names, table.T, strict=True))


def _number(value: float) -> str:
    return "" if np.isnan(value) else f"{value:.5g}"
