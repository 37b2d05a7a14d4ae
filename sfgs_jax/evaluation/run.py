"""Every metric of a finished run, from the files in its folder."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation.image_evaluation import LPIPS_PROTOCOL, ImageFigures, evaluate_images
from sfgs_jax.evaluation.image_metrics import PROTOCOLS, SPLATAM_EVERY
from sfgs_jax.evaluation.perceptual import LpipsWeights, load_lpips
from sfgs_jax.evaluation.run_folder import posed_frames, read_json
from sfgs_jax.evaluation.trajectory_metrics import ate, rpe
from sfgs_jax.geometry import InputError, read_tum, write_atomically
from sfgs_jax.splatting import load_ply

_PIXELS = 200 * 640 * 480

_OWN_KEYS = ("ate", "rpe", "psnr", "ssim", "lpips_squeeze", "evaluated", "unavailable")


def evaluate_run(
    run_dir: Path,
    recording: Recording,
    *,
    every: int | None = None,
    max_lpips_frames: int = 40,
    progress: Callable[..., object] | None = None,
) -> dict[str, Any]:
    """Compare a run with its recording and add the figures to its `metrics.json`.

    The trajectory is compared with the ground truth, and the map, rendered at every estimated pose, with the
    recorded images by the protocols of `image_metrics`. What can't be given is listed under `unavailable`
    with the reason. Doing it again replaces what was written before.

    Args:
        run_dir: folder with `trajectory.txt`, `keyframes.txt`, `map.ply` and `metrics.json`.
        recording: what the run was made on.
        every: image metrics take the last of every so many frames, and 1 takes them all. Where None, it is 1
            for short recordings and for longer ones the least multiple of five (SplaTAM's choice of frames)
            that keeps the work to 200 images of 640 x 480. `evaluated.every` says what it was.
        max_lpips_frames: LPIPS takes at most so many of SplaTAM's frames, evenly spaced;
            `evaluated.lpips_frames` says how many it took.
        progress: called as `progress(done)` with the number of frames of the recording gone through.

    Returns:
        All of `metrics.json`: `ate`, `rpe`, `psnr.PROTOCOL`, `ssim.PROTOCOL`, `lpips_squeeze.PROTOCOL`,
        `evaluated` and `unavailable`, besides what the run wrote there itself.

    Raises:
        InputError: a file of the run is missing, damaged, or belongs to another recording.
    """
    every = _affordable(recording) if every is None else every
    if every < 1:
        raise InputError(f"Image metrics take one frame of `every`, at least 1: {every} takes none.")
    path = run_dir / "metrics.json"
    kept = {key: value for key, value in read_json(path).items() if key not in _OWN_KEYS}
    unavailable: dict[str, str] = {}
    figures = _trajectory_figures(run_dir, recording, unavailable)

    weights = _lpips_weights(unavailable)
    posed = posed_frames(run_dir, recording)
    images = evaluate_images(
        load_ply(run_dir / "map.ply"),
        recording,
        posed,
        lpips_weights=weights,
        every=every,
        max_lpips_frames=max_lpips_frames,
        progress=progress,
    )
    figures |= _image_figures(images, unavailable)
    figures["evaluated"] = {
        "every": every,
        "frames": {name: len(images.psnr[name]) for name in PROTOCOLS},
        "lpips_frames": len(images.lpips),
        "without_pose": len(recording) - len(posed.indices),
        "unreadable": images.unreadable,
    }
    metrics = kept | figures | {"unavailable": unavailable}
    write_atomically(path, json.dumps(metrics, indent=2) + "\n")
    return metrics


def _affordable(recording: Recording) -> int:
    """Which share of the frames image metrics can take within a minute or so; see `evaluate_run`."""
    height, width = recording.camera.shape
    blocks = math.ceil(len(recording) * height * width / (_PIXELS * SPLATAM_EVERY))
    return 1 if len(recording) * height * width <= _PIXELS else SPLATAM_EVERY * blocks


def _trajectory_figures(run_dir: Path, recording: Recording, unavailable: dict[str, str]) -> dict[str, Any]:
    """ATE and RPE, or the reason why there are none."""
    truth = recording.ground_truth
    try:
        if truth is None:
            raise InputError("the recording has no ground truth")
        estimate = read_tum(run_dir / "trajectory.txt")
        absolute, relative = ate(estimate, truth), rpe(estimate, truth)
    except InputError as error:
        unavailable |= dict.fromkeys(("ate", "rpe"), str(error))
        return {}
    return {
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


def _lpips_weights(unavailable: dict[str, str]) -> LpipsWeights | None:
    """LPIPS's weights, or None with the reason."""
    try:
        return load_lpips()
    except InputError as error:
        unavailable["lpips_squeeze"] = str(error)
        return None


def _image_figures(images: ImageFigures, unavailable: dict[str, str]) -> dict[str, Any]:
    """Means over the scored frames; protocols without a frame are listed with the reason."""
    if not images.psnr["all"]:
        unavailable |= dict.fromkeys(("psnr", "ssim", "lpips_squeeze"), "no frame with a pose could be read")
        return {}
    figures: dict[str, Any] = {}
    for metric, values in (("psnr", images.psnr), ("ssim", images.ssim)):
        figures[metric] = {name: float(np.mean(values[name])) for name in PROTOCOLS if values[name]}
        for name in PROTOCOLS:
            if not values[name]:
                unavailable[f"{metric}.{name}"] = "none of the evaluated frames belongs to it"
    if images.lpips:
        figures["lpips_squeeze"] = {LPIPS_PROTOCOL: float(np.mean(images.lpips))}
    elif "lpips_squeeze" not in unavailable:
        unavailable["lpips_squeeze"] = "none of the evaluated frames belongs to its protocol"
    return figures
