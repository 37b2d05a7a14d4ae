"""Times of the rows of real and synthetic cameras, estimated while tracking, and what they do for the poses.

    python -m experiments.timing [--recordings redkitchen fr1_rpy kinect] [--frames 600]

Each recording is tracked three times, with the graph of keyframes and without a map. At first all rows count
as exposed at once. Then the times are estimated from there. At last they are known from that run. `kinect` is
the synthetic room seen by `datasets.KINECT_V1`, with true times of 15, 30 and 25 ms.
"""

import argparse
from dataclasses import replace

import numpy as np

from experiments.recordings import SOURCES
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.evaluation import ate, rpe
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam import SlamConfig, SlamState, estimated_timing, follow, init

RECORDINGS = {**SOURCES, "kinect": "synthetic:frames=120,kinect=1"}


def tracked(
    recording: Recording, num_frames: int, *, estimate: bool, timing: SensorTiming | None
) -> SlamState:
    """The state after the first frames.

    Args:
        recording: where they are from.
        num_frames: how many, at most.
        estimate: whether the times are estimated.
        timing: the times to start from; None for all rows at once.
    """
    config = SlamConfig()
    config = replace(config, tracking=replace(config.tracking, estimate_timing=estimate))
    state = init(recording.camera, config, timing)
    for number in range(min(num_frames, len(recording))):
        state = follow(state, recording[number], number=number).state
    return state


def print_row(name: str, how: str, recording: Recording, state: SlamState) -> None:
    """Errors of the poses, and the times with their standard deviations."""
    truth, found = recording.ground_truth, state.trajectory
    assert truth is not None
    scale = ate(found, truth, with_scale=True).alignment.scale
    ten = rpe(found, truth, delta=10)
    errors = (
        f"{100 * ate(found, truth).rmse_m:.2f} | {scale:.3f} | {100 * ten.trans_m:.2f} | {ten.rot_deg:.2f}"
    )
    timing, covariance = estimated_timing(state.params, state.tracker)
    sigmas = np.sqrt(np.diag(covariance))
    times = [f"{1e3 * t:.1f} ± {1e3 * s:.1f}" for t, s in zip(timing.vector, sigmas, strict=True)]
    told = " | ".join(times) if state.config.tracking.estimate_timing else "- | - | -"
    print(f"| {name} | {how} | {errors} | {state.num_lost} | {told} |", flush=True)


def main() -> None:
    """Print the table of the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument(
        "--recordings", nargs="*", default=["redkitchen", "fr1_rpy", "kinect"], choices=RECORDINGS
    )
    parser.add_argument("--frames", type=int, default=600)
    options = parser.parse_args()
    print(
        "| recording | rows | ATE cm | Sim(3) scale | RPE of 10 frames cm | deg | lost | delay ms "
        "| colour readout ms | depth readout ms |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    for name in options.recordings:
        recording, timing = open_recording(RECORDINGS[name]), None
        for how, estimate in (("at once", False), ("estimated", True), ("known before", True)):
            state = tracked(recording, options.frames, estimate=estimate, timing=timing)
            print_row(name, how, recording, state)
            timing = estimated_timing(state.params, state.tracker)[0]


if __name__ == "__main__":
    main()
