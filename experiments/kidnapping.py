"""A camera that is put elsewhere: another map, its merging, and poses that are wrong.

    python -m experiments.kidnapping [--sources room redkitchen fr1_rpy] [--starts 8] [--new-map-frames 30]

From each start the camera walks for a while, and is put to another place of the same recording, with no frame
in between. It walks on there, and then the whole way back to where it had been, so that the two places meet.
With `--new-map-frames 0` no map begins, as before there were several.

A frame is wrong if its map puts it more than 10 cm from the truth, once the map is aligned with the truth.
Real recordings are found through SFGS_DATA, by default `../shared`.
"""

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from experiments.matching_tables import print_table
from experiments.recordings import SOURCES
from experiments.robustness_scores import WRONG_M
from sfgs_jax import slam
from sfgs_jax.datasets import Recording, open_recording
from sfgs_jax.evaluation import align_points
from sfgs_jax.geometry import Frame


class Walk(NamedTuple):
    """A recording and the ways that are cut from it, in frames.

    Attributes:
        source: of the recording.
        before: frames before the camera is put elsewhere.
        jump: frames that it misses.
        stride: frames from one to the next.
    """

    source: str
    before: int
    jump: int
    stride: int


WALKS = {
    "room": Walk("synthetic:width=320,height=240,frames=480", 100, 200, 2),
    "redkitchen": Walk(SOURCES["redkitchen"], 100, 250, 2),
    "fr1_rpy": Walk(SOURCES["fr1_rpy"], 60, 90, 1),
}


class Outcome(NamedTuple):
    """Counts of a walk.

    Attributes:
        frames: in all.
        tracked: frames with a pose in some map.
        begun: maps that began beside the first.
        left: maps at the end.
        wrong: frames with a wrong pose.
        rmse_m: error of the positions in the largest map, metres.
    """

    frames: int
    tracked: int
    begun: int
    left: int
    wrong: int
    rmse_m: float


def way_of(walk: Walk, start: int) -> list[int]:
    """Numbers of the frames: to where the camera is taken away, on where it is put, and all the way back."""
    before = range(start, start + walk.before, walk.stride)
    put = start + walk.before + walk.jump
    after = range(put, put + walk.before, walk.stride)
    back = range(put + walk.before, start, -walk.stride)
    return [*before, *after, *back]


def walked(recording: Recording, way: list[int], config: slam.SlamConfig) -> Outcome:
    """Track a way through a recording and compare it with the truth.

    Args:
        recording: with ground truth.
        way: numbers of its frames.
        config: settings.
    """
    state, begun = slam.init(recording.camera, config), 0
    for place, number in enumerate(way):
        frame = recording[number]
        state, info, _ = slam.follow(state, Frame(frame.rgb, frame.depth, place / 30))
        begun += info.new_map
    run, wrong, rmse = slam.Run(slam.finish(state)), 0, float("nan")
    truth = true_positions(recording, way)
    for number, part in enumerate(run.maps):
        positions = part.trajectory.positions
        true = truth[np.round(30 * part.trajectory.timestamps).astype(int)]
        errors = errors_of(positions, true)
        wrong += int((errors > WRONG_M).sum())
        rmse = float(np.sqrt(np.mean(errors**2))) if number == 0 else rmse
    return Outcome(len(way), len(state.log.timestamps), begun, len(run.maps), wrong, rmse)


def true_positions(recording: Recording, way: list[int]) -> Float[np.ndarray, "n 3"]:
    """The true positions of frames, those nearest in time."""
    truth = recording.ground_truth
    assert truth is not None
    times = recording.timestamps[way]
    nearest = np.abs(truth.timestamps[None] - times[:, None]).argmin(axis=1)
    return truth.positions[nearest]


def errors_of(positions: Float[np.ndarray, "n 3"], true: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Distances from the truth, metres, aligned by the half of the positions that fits it best."""
    kept, errors = np.ones(len(true), bool), np.zeros(len(true))
    for _ in range(10):
        errors = np.linalg.norm(align_points(positions[kept], true[kept]).transform(positions) - true, axis=1)
        kept = errors <= np.median(errors)
    return errors


def table(name: str, starts: int, config: slam.SlamConfig) -> Iterator[tuple[str, ...]]:
    """A row for each start in a recording."""
    walk = WALKS[name]
    recording = open_recording(walk.source)
    room = len(recording) - 2 * walk.before - walk.jump - 1
    for start in np.linspace(0, room, starts).astype(int).tolist():
        found = walked(recording, way_of(walk, start), config)
        yield name, str(start), *map(str, found[:5]), f"{100 * found.rmse_m:.2f}"


def main() -> None:
    """Print a row for each start."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--sources", nargs="+", default=list(WALKS), choices=list(WALKS))
    parser.add_argument("--starts", type=int, default=8)
    parser.add_argument("--new-map-frames", type=int, default=slam.GraphConfig().new_map_frames)
    options = parser.parse_args()
    config = slam.SlamConfig()
    config = replace(config, graph=replace(config.graph, new_map_frames=options.new_map_frames))
    columns = ("recording", "start", "frames", "tracked", "maps begun", "maps left", "wrong", "RMSE, cm")
    rows = chain.from_iterable(table(name, options.starts, config) for name in options.sources)
    print_table("A camera that is put elsewhere and walks back", columns, rows)


if __name__ == "__main__":
    main()
