"""How clearly do faults of a sensor show, and how far are recordings without them from being suspected?

    python -m experiments.contradictions [--recordings room redkitchen ...] [--frames 200]

The limits of `TrackingConfig` lie between the two: `max_scale_change` between the largest change of the scale
of depth that a recording as it is seems to have, and what a real change of 3 or 5 % from the middle on looks
like; `max_depth_scatter` above the scatter of any of them. The last columns are for depth that is late by
some frames. They name the frame after which that counts in covariances, and the one after which frames are
refused for it.

Real recordings are found through SFGS_DATA, by default `../shared`; one that is not there is left out with a
line.
"""

import argparse
from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Float

from experiments.perturbations import PERTURBATIONS
from experiments.recordings import DATA, SOURCES
from experiments.starts import in_memory
from sfgs_jax.datasets import ReaderOptions, Recording
from sfgs_jax.slam import PRESETS, TrackingConfig, init_tracker, track, tracker_params
from sfgs_jax.slam.frontend import is_noise, watched
from sfgs_jax.slam.state import empty_synchrony
from sfgs_jax.superfeats import mean_grey

RECORDINGS = {
    "room": "synthetic:frames=240,noise=1",
    "kinect room": "synthetic:frames=240,kinect=1",
    "ring": "synthetic:place=ring,frames=400,noise=1",
    "building": "synthetic:place=building,frames=400,noise=1,width=320,height=240",
    "redkitchen": SOURCES["redkitchen"],
    "fr1_rpy": SOURCES["fr1_rpy"],
    "tartanair": str(DATA / "tartanair" / "hospital_clip"),
}
LAGS = (1, 2, 3, 5)
CHANGES = (3, 5)
SEED = 0


def scale_changes(recording: Recording, config: TrackingConfig) -> Float[np.ndarray, " n"]:
    """Change of the scale of depth from each tracked frame's reference; NaN for the others.

    Args:
        recording: any.
        config: settings.
    """
    params = tracker_params(recording.camera, config)
    tracker, changes, before = init_tracker(params), np.full(len(recording), np.nan), np.nan
    for number in range(len(recording)):
        frame = recording[number]
        elapsed = np.float32(np.nan_to_num(frame.timestamp - before))
        before = frame.timestamp
        tracker, info = track(params, tracker, mean_grey(np.asarray(frame.rgb)), frame.depth, elapsed)
        if bool(info.tracked) and number:
            changes[number] = -float(info.registration.scale_change)
    return changes


def noticed_after(recording: Recording, max_lag: int) -> tuple[int | None, int | None]:
    """Frames after which a lag of depth counts in covariances, and after which frames are refused for it.

    None stands for never.

    Args:
        recording: any.
        max_lag: as of `TrackingConfig.max_depth_lag`.
    """
    synchrony, counts, refuses = empty_synchrony(recording.camera), None, None
    for number in range(len(recording)):
        synchrony = watched(synchrony, recording[number], max_lag)
        if synchrony.lag and counts is None:
            counts = number
        if synchrony.refused_lag and refuses is None:
            refuses = number
    return counts, refuses


def scatter(depth: Float[np.ndarray, "H W"]) -> float:
    """Least limit at which depth is no noise, a share of depth, to a hundredth of a percent.

    Args:
        depth: metres.
    """
    judge, low, high = jax.jit(is_noise), 0.0, 0.2
    while high - low > 1e-4:
        middle = (low + high) / 2
        low, high = (middle, high) if bool(judge(depth, middle)) else (low, middle)
    return high


def row(name: str, recording: Recording, config: TrackingConfig) -> str:
    """A line of the Markdown table.

    Args:
        name: of the recording.
        recording: as it is.
        config: settings of its preset.
    """
    # Nothing is refused, so that the frames after a change are measured too.
    lenient = replace(config, max_scale_change=1e3)
    plain = 100 * np.nanmax(np.abs(scale_changes(recording, lenient)))
    cells = [f"{plain:.2f}"]
    middle = len(recording) // 2
    for percent in CHANGES:
        perturbed = PERTURBATIONS["change of depth scale"].apply(recording, percent, SEED)
        cells.append(f"{100 * scale_changes(perturbed, lenient)[middle]:.1f}")
    largest = max(scatter(np.asarray(recording[number].depth)) for number in range(0, len(recording), 10))
    cells.append(f"{100 * largest:.2f}")
    for lag in (0, *LAGS):
        late = PERTURBATIONS["late depth"].apply(recording, lag, SEED) if lag else recording
        counts, refuses = noticed_after(late, config.max_depth_lag)
        cells.append(f"{counts or 'never'} / {refuses or 'never'}")
    return f"| {name} | {' | '.join(cells)} |"


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="How clearly faults of a sensor show.")
    parser.add_argument("--recordings", nargs="+", default=list(RECORDINGS), choices=list(RECORDINGS))
    parser.add_argument("--frames", type=int, default=200, help="first frames of each recording")
    options = parser.parse_args(arguments)
    columns = ["recording", "largest change %", *(f"at {change} %" for change in CHANGES), "scatter %"]
    columns += ["counts / refused: as it is", *(f"late by {lag}" for lag in LAGS)]
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for name in options.recordings:
        recording = in_memory(name, RECORDINGS[name], ReaderOptions(end=options.frames))
        if recording is not None:
            print(row(name, recording, PRESETS[recording.dataset].tracking), flush=True)


if __name__ == "__main__":
    main()
