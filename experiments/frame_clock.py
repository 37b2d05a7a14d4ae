"""What are even intervals worth? Motions divided by the clock's intervals, and by those between time stamps.

    python -m experiments.frame_clock

Recordings as they are, and with stamps that jitter. Rows that are not exposed at once move by the motion
between two frames, divided by their interval. Excess says how far the frames contradict each other about the
times of the rows. It is 1 if they are as exact as they claim.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from experiments.contradictions import RECORDINGS
from experiments.matching_tables import print_table
from experiments.starts import in_memory
from sfgs_jax import slam
from sfgs_jax.datasets import ReaderOptions, Recording
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import Trajectory
from sfgs_jax.sensors import FrameClock

SOURCES = {
    "fr1_rpy": RECORDINGS["fr1_rpy"],
    "kinect": "synthetic:kinect=1,frames=300,width=320,height=240",
}
JITTER_S = {"fr1_rpy": (0.0,), "kinect": (0.0, 0.003)}
COLUMNS = (
    "recording",
    "jitter ms",
    "intervals of",
    "ATE as tracked cm",
    "at the end cm",
    "times ms",
    "excess",
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="What are even intervals worth?")
    parser.add_argument("--recordings", nargs="+", choices=SOURCES, default=list(SOURCES))
    parser.add_argument("--frames", type=int, default=300, help="of each recording")
    given = parser.parse_args()
    print_table("intervals between frames", COLUMNS, _rows(given.recordings, given.frames))


def _rows(names: list[str], frames: int) -> Iterator[tuple[str, ...]]:
    for name in names:
        recording = in_memory(name, str(SOURCES[name]), ReaderOptions())
        if recording is None:
            continue
        for jitter in JITTER_S[name]:
            for intervals in ("stamps", "clock"):
                cells = _cells(recording, min(frames, len(recording)), jitter, by_clock=intervals == "clock")
                yield (name, f"{1e3 * jitter:.0f}", intervals, *cells)


def _cells(recording: Recording, count: int, jitter: float, *, by_clock: bool) -> tuple[str, ...]:
    """Figures of a run."""
    config = slam.PRESETS.get(recording.dataset, slam.SlamConfig())
    tracking = replace(config.tracking, estimate_timing=True, estimate_depth=True)
    state = slam.init(recording.camera, replace(config, tracking=tracking))
    off = np.random.default_rng(0).normal(0, jitter, count) if jitter else np.zeros(count)
    stamps = np.maximum.accumulate(recording.timestamps[:count] + off)
    poses, tracked = [], []
    for number in range(count):
        if not by_clock and number:
            last = stamps[number - 1].item()
            state = replace(state, clock=FrameClock(last, last, count=1))
        frame = replace(recording[number], timestamp=stamps[number].item())
        state, info, _ = slam.follow(state, frame, number=number)
        if info.tracked:
            poses.append(np.asarray(info.T_world_cam.as_matrix(), float))
            tracked.append(number)
    times = slam.estimated_timing(state.params, state.tracker)[0].on_host()
    told = state.tracker.timing
    end = slam.finish(state).trajectory
    true_stamps, truth = recording.timestamps[tracked], recording.ground_truth
    assert truth is not None
    errors = (
        100 * ate(Trajectory(true_stamps, at), truth).rmse_m
        for at in (np.stack(poses), np.asarray(end.poses))
    )
    return (
        *(f"{error:.2f}" for error in errors),
        ", ".join(f"{1e3 * time:.1f}" for time in times),
        f"{float(told.chi_square / told.expected):.1f}",
    )


if __name__ == "__main__":
    main()
