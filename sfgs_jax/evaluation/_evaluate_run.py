"""Every metric of a finished run, from the files in its folder."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sfgs_jax.arrays import InputError, checked, write_atomically
from sfgs_jax.datasets import Recording, associate
from sfgs_jax.evaluation._run_folder import SAME_TIME_S, PosedFrames, posed_frames, read_json
from sfgs_jax.evaluation.images import (
    FRAMES_FILE,
    LPIPS_PROTOCOL,
    PROTOCOLS,
    SPLATAM_EVERY,
    ImageFigures,
    LpipsWeights,
    evaluate_images,
    format_frames,
    load_lpips,
    mean_by_protocol,
)
from sfgs_jax.evaluation.trajectory import Ate, ate, nees, rpe
from sfgs_jax.geometry import Trajectory, read_covariances, read_tum
from sfgs_jax.splatting import load_ply

MAX_PIXELS = 200 * 640 * 480
"""Most pixels that image metrics score by default: 200 images of 640 x 480, about a minute's work."""

_OWN_KEYS = (
    "ate",
    "rpe",
    "nees",
    "psnr",
    "ssim",
    "depth_l1_m",
    "coverage",
    "lpips_squeeze",
    "evaluated",
    "unavailable",
)


@checked
def evaluate_run(
    run_dir: Path,
    recording: Recording,
    *,
    every: int | None = None,
    max_pixels: int = MAX_PIXELS,
    max_lpips_frames: int = 40,
    progress: Callable[..., object] | None = None,
) -> dict[str, Any]:
    """Compare a run with its recording and add the figures to its `metrics.json`.

    The trajectory is compared with the ground truth. The map is rendered at every estimated pose and compared
    with the recorded images by every protocol. Metrics that can't be given are listed under `unavailable`
    with the reason. A table of every scored frame, `frames.csv`, is written beside it. A second evaluation
    replaces the figures of the first.

    Args:
        run_dir: folder with `trajectory.txt`, `keyframes.txt`, `map.ply` and `metrics.json`.
        recording: the recording of the run.
        every: n scores the last of every n frames. None takes 1 for short recordings, else the least multiple
            of five (SplaTAM's choice of frames) that keeps within `max_pixels`; see `evaluated.every`.
        max_pixels: most pixels to score if `every` is None, over all frames.
        max_lpips_frames: most frames for LPIPS, evenly spaced over SplaTAM's; `evaluated.lpips_frames` holds
            their number.
        progress: called as `progress(done)` with the number of frames of the recording gone through.

    Returns:
        All of `metrics.json`: `ate`, `rpe`, `nees`, `psnr.PROTOCOL`, `ssim.PROTOCOL`,
        `lpips_squeeze.PROTOCOL`, `evaluated` and `unavailable`, besides what the run wrote there itself.

    Raises:
        InputError: a file of the run is missing, damaged, or of another recording; or `every` is below 1.
    """
    every = _affordable(recording, max_pixels) if every is None else every
    if every < 1:
        raise InputError(f"Image metrics score one frame in `every`, which is at least 1, not {every}.")
    path = run_dir / "metrics.json"
    kept = {key: value for key, value in read_json(path).items() if key not in _OWN_KEYS}
    unavailable: dict[str, str] = {}
    figures, absolute = _trajectory_figures(run_dir, recording, unavailable)
    posed = posed_frames(run_dir, recording)
    images = evaluate_images(
        load_ply(run_dir / "map.ply"),
        recording,
        posed,
        lpips_weights=_lpips_weights(unavailable),
        every=every,
        max_lpips_frames=max_lpips_frames,
        progress=progress,
    )
    figures |= _image_figures(images, unavailable)
    figures["evaluated"] = {
        "every": every,
        **_scored_frames(images),
        "without_pose": len(recording) - len(posed.indices),
    }
    metrics = kept | figures | {"unavailable": unavailable}
    write_atomically(run_dir / FRAMES_FILE, _frames_table(images, recording, posed, absolute))
    write_atomically(path, json.dumps(metrics, indent=2) + "\n")
    return metrics


def _scored_frames(images: ImageFigures) -> dict[str, Any]:
    """How many frames there are figures of."""
    return {
        "frames": {name: sum(name in frame.psnr for frame in images.frames) for name in PROTOCOLS},
        "lpips_frames": sum(frame.lpips is not None for frame in images.frames),
        "unreadable": images.unreadable,
    }


def _affordable(recording: Recording, max_pixels: int) -> int:
    """The default of `every`; see `evaluate_run`."""
    height, width = recording.camera.shape
    pixels = len(recording) * height * width
    return 1 if pixels <= max_pixels else SPLATAM_EVERY * math.ceil(pixels / (max_pixels * SPLATAM_EVERY))


def _frames_table(
    images: ImageFigures, recording: Recording, posed: PosedFrames, absolute: Ate | None
) -> str:
    """Text of `frames.csv`."""
    errors = _by_index(absolute, recording) if absolute else {}
    gains = dict(zip(posed.indices.tolist(), posed.gains, strict=True))
    return format_frames(images.frames, errors, gains)


def _by_index(absolute: Ate, recording: Recording) -> dict[int, float]:
    """Position errors by the positions of their frames in the recording, metres."""
    pairs = associate(recording.timestamps, absolute.timestamps, SAME_TIME_S)
    return {int(index): float(absolute.errors_m[row]) for index, row in pairs}


def _trajectory_figures(
    run_dir: Path, recording: Recording, unavailable: dict[str, str]
) -> tuple[dict[str, Any], Ate | None]:
    """ATE and RPE; without them the reason is added to `unavailable`."""
    truth = recording.ground_truth
    try:
        if truth is None:
            raise InputError("the recording has no ground truth")
        estimate = read_tum(run_dir / "trajectory.txt")
        absolute, relative = ate(estimate, truth), rpe(estimate, truth)
    except InputError as error:
        unavailable |= dict.fromkeys(("ate", "rpe", "nees"), str(error))
        return {}, None
    figures = {
        "ate": {
            "rmse_m": absolute.rmse_m,
            "mean_m": absolute.mean_m,
            "median_m": absolute.median_m,
            "max_m": absolute.max_m,
            "num_pairs": absolute.num_pairs,
        },
        "rpe": {
            "trans_m": relative.trans_m,
            "rot_deg": relative.rot_deg,
            "delta_frames": relative.delta,
            "num_pairs": relative.num_pairs,
        },
    }
    return figures | _consistency_figures(run_dir, estimate, truth, unavailable), absolute


def _consistency_figures(
    run_dir: Path, estimate: Trajectory, truth: Trajectory, unavailable: dict[str, str]
) -> dict[str, Any]:
    """How well the covariances cover the errors; without them the reason is added to `unavailable`."""
    try:
        timestamps, covariances = read_covariances(run_dir / "trajectory_covariance.txt")
        if not np.array_equal(timestamps, estimate.timestamps):
            raise InputError("trajectory_covariance.txt is of other frames than trajectory.txt")
        found = nees(estimate, covariances, truth)
    except InputError as error:
        unavailable["nees"] = str(error)
        return {}
    return {"nees": {"mean": found.mean, "within_3_sigma": found.share_within(3.0)}}


def _lpips_weights(unavailable: dict[str, str]) -> LpipsWeights | None:
    """Weights of LPIPS; without them None, and the reason is added to `unavailable`."""
    try:
        return load_lpips()
    except InputError as error:
        unavailable["lpips_squeeze"] = str(error)
        return None


def _image_figures(images: ImageFigures, unavailable: dict[str, str]) -> dict[str, Any]:
    """Means over the scored frames; protocols without a frame are added to `unavailable`."""
    if not images.frames:
        unavailable |= dict.fromkeys(("psnr", "ssim", "lpips_squeeze"), "no frame with a pose could be read")
        return {}
    figures: dict[str, Any] = {
        "psnr": mean_by_protocol(frame.psnr for frame in images.frames),
        "ssim": mean_by_protocol(frame.ssim for frame in images.frames),
        "coverage": float(np.mean([frame.coverage for frame in images.frames])),
    }
    for name in PROTOCOLS:
        if name not in figures["psnr"]:
            reason = "none of the evaluated frames belongs to it"
            unavailable |= dict.fromkeys((f"psnr.{name}", f"ssim.{name}"), reason)
    distances = [frame.depth_l1_m for frame in images.frames if not np.isnan(frame.depth_l1_m)]
    if distances:
        figures["depth_l1_m"] = float(np.mean(distances))
    else:
        unavailable["depth_l1_m"] = "no frame has depth where the map is opaque"
    perceptual = [frame.lpips for frame in images.frames if frame.lpips is not None]
    if perceptual:
        figures["lpips_squeeze"] = {LPIPS_PROTOCOL: float(np.mean(perceptual))}
    elif "lpips_squeeze" not in unavailable:
        unavailable["lpips_squeeze"] = "none of the evaluated frames belongs to its protocol"
    return figures
