"""Keyframes tell that focal lengths are wrong: how well, and are right ones suspected?

    python -m experiments.focal_lengths [--recordings room redkitchen ...] [--stride 3] [--errors -3 0 3]

Each recording is tracked with focal lengths that are wrong by each error. The estimate is that after the last
frame, with its standard deviation. The column `sure` has the largest estimate at any frame that chance does
not explain. `TrackingConfig.max_focal_error` has to lie above those with right focal lengths. The last
columns say at which frame an estimate was beyond a limit, chance allowed for.

Real recordings are found through SFGS_DATA, by default `../shared`; one that is not there is left out with a
line.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from experiments.contradictions import RECORDINGS
from experiments.starts import in_memory
from sfgs_jax import slam
from sfgs_jax.datasets import ReaderOptions, Recording

PLACES = {
    **RECORDINGS,
    # Slow enough to be tracked.
    "building": "synthetic:place=building,frames=3000,noise=1,width=320,height=240",
    "desk": "synthetic:place=desk,frames=300",
    "wall": "synthetic:place=wall,frames=200",
    "sphere": "synthetic:place=sphere,frames=200",
    "twins": "synthetic:place=twins,frames=400",
}
NOTHING = 1.0
"""A limit that no estimate passes."""


class Told(NamedTuple):
    """What was known after each frame.

    Attributes:
        estimates: (n,) logarithm of the true focal lengths over those in use.
        sigmas: (n,) their standard deviations.
        sure: (n,) size of the estimates that are not chance; 0 for the others.
        beyond: (n, l) whether they are beyond each limit, chance allowed for.
        tracked: frames that were tracked.
    """

    estimates: Float[np.ndarray, " n"]
    sigmas: Float[np.ndarray, " n"]
    sure: Float[np.ndarray, " n"]
    beyond: Bool[np.ndarray, "n l"]
    tracked: int


def told(recording: Recording, error: float, config: slam.SlamConfig, limits: Sequence[float]) -> Told:
    """Track a recording with wrong focal lengths.

    Args:
        recording: any.
        error: share by which its focal lengths are too long.
        config: settings.
        limits: of the estimate, as shares.
    """
    camera = recording.camera
    camera = replace(camera, fx=camera.fx * (1 + error), fy=camera.fy * (1 + error))
    config = replace(config, tracking=replace(config.tracking, max_focal_error=NOTHING))
    state, found, beyond, tracked = slam.init(camera, config), [], [], 0
    for number in range(len(recording)):
        state, info, _ = slam.follow(state, recording[number])
        tracked += info.tracked
        focal = state.graph.focal
        estimate, sigma = focal.estimate()
        found.append((estimate, sigma, abs(estimate) if focal.is_beyond(0.0) else 0.0))
        beyond.append([focal.is_beyond(limit) for limit in limits])
    estimates, sigmas, sure = np.transpose(found)
    return Told(estimates, sigmas, sure, np.asarray(beyond), tracked)


def row(name: str, recording: Recording, error: float, limits: Sequence[float]) -> str:
    """A line of the Markdown table.

    Args:
        name: of the recording.
        recording: as it is.
        error: percent by which focal lengths are too long.
        limits: percent.
    """
    shares = [limit / 100 for limit in limits]
    found = told(recording, error / 100, slam.PRESETS[recording.dataset], shares)
    cells = [
        f"{100 * found.estimates[-1]:.2f} ± {100 * found.sigmas[-1]:.2f}",
        f"{100 * max(found.sure):.2f}",
    ]
    cells += [str(np.argmax(beyond)) if beyond.any() else "never" for beyond in found.beyond.T]
    return f"| {name} | {error:g} | {found.tracked} of {len(recording)} | {' | '.join(cells)} |"


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description="How well keyframes tell that focal lengths are wrong.")
    parser.add_argument("--recordings", nargs="+", default=list(PLACES), choices=list(PLACES))
    parser.add_argument("--frames", type=int, default=150, help="frames of each recording")
    parser.add_argument("--start", type=int, default=0, help="first frame")
    parser.add_argument("--stride", type=int, default=1, help="from frame to frame")
    parser.add_argument("--errors", type=float, nargs="+", default=[-3, 0, 3], help="percent too long")
    parser.add_argument("--limits", type=float, nargs="+", default=[1.5, 2, 2.5], help="percent")
    options = parser.parse_args(arguments)
    columns = ["recording", "error %", "tracked", "estimate %", "sure %"]
    columns += [f"beyond {limit:g} % at frame" for limit in options.limits]
    print(f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}")
    for name in options.recordings:
        end = options.start + options.stride * options.frames
        reader = ReaderOptions(start=options.start, end=end, stride=options.stride)
        recording = in_memory(name, PLACES[name], reader)
        if recording is None:
            continue
        for error in options.errors:
            print(row(name, recording, error, options.limits), flush=True)


if __name__ == "__main__":
    main()
