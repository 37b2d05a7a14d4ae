"""The model of the sensors, estimated during a run: what it finds, and what it does for the poses.

    python -m experiments.sensors [--recordings redkitchen fr1_rpy kinect noise] [--frames 600]

A recording is a name of the table below, or as of `sfgs-jax run`: a path, or `synthetic:kinect=1,seed=2`.

Each recording is tracked with and without the times of the rows (`estimate_timing`), the distortion of depth
(`estimate_depth`) and its camera's place (`estimate_extrinsic`), with the graph of keyframes and without a
map. `kinect` is the synthetic room seen by `datasets.KINECT_V1`, with true times of 15, 30 and 25 ms and a
depth camera that is 10 mm and 0.3 degrees beside; `noise` has no such faults.

*Cycle* is the median error of the motions around three keyframes, each registered to the others. *Epipolar*
is how far matches of another extractor lie from their epipolar lines (`experiments.epipolar`). Both need no
truth. The first row of a recording is of the poses that come with it.
"""

import argparse
from dataclasses import replace
from itertools import chain, product

import jax
import numpy as np
from jaxtyping import Float

from experiments.epipolar import Pair, epipolar_error, matched_pairs
from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from sfgs_jax.datasets import Recording, Selection, SyntheticRecording, open_recording
from sfgs_jax.evaluation import ate, rpe
from sfgs_jax.geometry import se3
from sfgs_jax.slam import SlamConfig, SlamState, estimated_depth, estimated_timing, finish, follow, init

RECORDINGS = {
    **SOURCES,
    "kinect": "synthetic:frames=150,kinect=1",
    "noise": "synthetic:frames=150,noise=1",
}
COLUMNS = (
    "modelled",
    "ATE cm",
    "Sim(3) scale",
    "RPE of 10 frames cm",
    "deg",
    "cycle cm",
    "deg",
    "epipolar px",
    "lost",
    "delay ms",
    "colour readout ms",
    "depth readout ms",
    "depth mm at 2 m",
    "error of that",
    "extrinsic mm",
    "error of that",
    "extrinsic deg",
    "error of that",
)
AT = 2.0
"""Depth at which the distortion is given, metres."""


VARIANTS = ((), ("depth",), ("timing",), ("timing", "depth"), ("timing", "depth", "extrinsic"))
"""Modelled: times of the rows, distortion of depth, and where its camera is beside the other."""


def tracked(recording: Recording, num_frames: int, modelled: tuple[str, ...]) -> SlamState:
    """The state after the first frames.

    Args:
        recording: where they are from.
        num_frames: how many, at most.
        modelled: one of the variants.
    """
    settings = {f"estimate_{name}": True for name in modelled}
    tracking = replace(SlamConfig().tracking, **settings)
    state = init(recording.camera, replace(SlamConfig(), tracking=tracking))
    for number in range(min(num_frames, len(recording))):
        state = follow(state, recording[number], number=number).state
    return finish(state)


def cycles(state: SlamState) -> tuple[float, float]:
    """Median errors of the motions around three keyframes, centimetres and degrees."""
    poses = {
        (e.target, e.source): se3.matrices_of(e.T_target_source[None])[0].astype(float)
        for e in state.graph.edges
    }
    around = [
        np.linalg.inv(poses[a, c]) @ poses[a, b] @ poses[b, c]
        for (a, b), (start, c) in product(poses, poses)
        if start == a and (b, c) in poses
    ]
    if not around:
        return float("nan"), float("nan")
    off = se3.logs_of(np.stack(around))
    lengths, angles = (np.linalg.norm(part, axis=1) for part in (off[:, :3], off[:, 3:]))
    return 100 * float(np.median(lengths)), float(np.degrees(np.median(angles)))


def epipolar(recording: Recording, poses: dict[int, Float[np.ndarray, "4 4"]], pairs: list[Pair]) -> str:
    """Epipolar error of some poses, pixels; none without pairs."""
    return f"{epipolar_error(pairs, poses, float(recording.camera.fx)):.2f}" if pairs else "-"


def row(recording: Recording, state: SlamState, pairs: list[Pair]) -> tuple[str, ...]:
    """A run's row of the table."""
    truth, found, tracking = recording.ground_truth, state.trajectory, state.config.tracking
    assert truth is not None
    ten, cycle = rpe(found, truth, delta=10), cycles(state)
    by_number = dict(zip(state.log.numbers.tolist(), found.poses, strict=True))
    on = [name for name in VARIANTS[-1] if getattr(tracking, f"estimate_{name}")]
    return (
        " and ".join(on) or "nothing",
        f"{100 * ate(found, truth).rmse_m:.2f}",
        f"{ate(found, truth, with_scale=True).alignment.scale:.3f}",
        f"{100 * ten.trans_m:.2f}",
        f"{ten.rot_deg:.2f}",
        f"{cycle[0]:.2f}",
        f"{cycle[1]:.2f}",
        epipolar(recording, by_number, pairs),
        str(state.num_lost),
        *times(state),
        *distortion(recording, state),
        *extrinsic(recording, state),
    )


def times(state: SlamState) -> tuple[str, ...]:
    """The three times with their standard deviations, milliseconds."""
    if not state.config.tracking.estimate_timing:
        return ("-",) * 3
    timing, covariance = estimated_timing(state.params, state.tracker)
    pairs = zip(timing.vector, np.sqrt(np.diag(covariance)), strict=True)
    return tuple(f"{1e3 * t:.1f} ± {1e3 * sigma:.1f}" for t, sigma in pairs)


def distortion(recording: Recording, state: SlamState) -> tuple[str, str]:
    """Root mean square of the offsets with that of their deviations, and of their error where it is known."""
    estimate = estimated_depth(state)
    if estimate is None:
        return "-", "-"
    correction, covariance = estimate
    found = np.asarray(correction.image(recording.camera))
    size, sigma = millimetres(found), millimetres(np.sqrt(np.diag(covariance)[:-6]))
    inner = _synthetic(recording)
    if inner is None:
        return f"{size:.1f} ± {sigma:.1f}", "-"
    return f"{size:.1f} ± {sigma:.1f}", f"{millimetres(found - inner.inverse_depth_offsets):.1f}"


def extrinsic(recording: Recording, state: SlamState) -> tuple[str, ...]:
    """Length and angle of the extrinsic with the root mean square deviation, each with its error if known."""
    estimate = estimated_depth(state)
    if estimate is None or estimate[0].extrinsic is None:
        return ("-",) * 4
    found, variances = np.asarray(estimate[0].extrinsic, float), np.diag(estimate[1])[-6:]
    inner, cells = _synthetic(recording), []
    truth = None if inner is None else se3.logs_of(inner.T_colour_depth[None])[0]
    for part, unit, digits in ((slice(0, 3), 1e3, 1), (slice(3, 6), 180 / np.pi, 2)):
        size, sigma = np.linalg.norm(found[part]), np.sqrt(variances[part].sum())
        cells.append(f"{unit * size:.{digits}f} ± {unit * sigma:.{digits}f}")
        error = None if truth is None else unit * np.linalg.norm(found[part] - truth[part])
        cells.append("-" if error is None else f"{error:.{digits}f}")
    return tuple(cells)


def _synthetic(recording: Recording) -> SyntheticRecording | None:
    inner = recording.recording if isinstance(recording, Selection) else recording
    return inner if isinstance(inner, SyntheticRecording) else None


def millimetres(offsets: np.ndarray) -> float:
    """Root mean square of offsets of inverse depth, as millimetres at `AT`.

    Args:
        offsets: 1/m.
    """
    return 1e3 * AT**2 * float(np.sqrt(np.mean(offsets**2)))


def main() -> None:
    """Print a table for each of the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--recordings", nargs="+", default=["redkitchen", "fr1_rpy", "kinect", "noise"])
    parser.add_argument("--frames", type=int, default=600)
    options = parser.parse_args()
    names: list[str] = options.recordings
    for name in names:
        recording = open_recording(RECORDINGS.get(name, name))
        truth = recording.ground_truth
        assert truth is not None
        own = dict(enumerate(truth.poses[: options.frames]))
        pairs = matched_pairs(recording, own)
        first = "its own poses", *("-",) * 6, epipolar(recording, own, pairs), *("-",) * (len(COLUMNS) - 8)
        rest = (row(recording, tracked(recording, options.frames, v), pairs) for v in VARIANTS)
        print_table(name, COLUMNS, chain([first], rest))
        # A process has room for a limited number of programs.
        jax.clear_caches()


if __name__ == "__main__":
    main()
