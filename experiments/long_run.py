"""A long run: time of a frame, memory and keyframes by parts of the run, then the error and wrong edges.

    python -m experiments.long_run synthetic:place=building,frames=10000 [--without-map]
    python -m experiments.long_run synthetic:place=desk,frames=2500 --holes

A camera that has been everywhere should cost the same in the last part as in the second, in time and in
memory. A frame's time is that of its pose and of the graph; the map grows beside it, and is not refined at
the end. Memory is the process's own, without files that are mapped into it.
"""

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sfgs_jax import datasets, evaluation, slam
from sfgs_jax.arrays import keep_freed_memory
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Frame, Trajectory, se3

_WRONG_METRES, _WRONG_RADIANS = 0.1, 0.1
"""Error of an edge's motion beyond which it is wrong."""


def main() -> None:
    """Run, and print a row for each part as it ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("source", help="recording with ground truth")
    parser.add_argument("--part", type=int, default=1000, help="frames of a row")
    parser.add_argument("--realtime", action="store_true", help="map in a thread of its own")
    parser.add_argument(
        "--holes", action="store_true", help="no depth in half of each image, elsewhere in each frame"
    )
    parser.add_argument("--without-map", action="store_true", help="poses alone: no table, the same error")
    options = parser.parse_args()
    keep_freed_memory()  # as the command does
    recording = datasets.open_recording(options.source)
    if recording.ground_truth is None:
        raise SystemExit("The recording has no ground truth.")
    frames = _frames(recording, holes=options.holes)
    config = slam.SlamConfig()
    config = replace(config, mapping=replace(config.mapping, final_steps=0))
    if options.without_map:
        state = slam.init(recording.camera, config)
        for number, frame in frames:
            state, _, _ = slam.follow(state, frame, number=number)
        print(_summary(slam.finish(state), recording.ground_truth))
        return
    rows = _Rows(options.part, len(recording))
    with tempfile.TemporaryDirectory() as folder:
        run = slam.run(
            frames,
            recording.camera,
            config,
            observer=rows,
            storage=Path(folder),
            realtime=options.realtime,
        )
    print(_summary(run.state, recording.ground_truth))


def _frames(recording: Recording, *, holes: bool) -> Iterator[tuple[int, Frame]]:
    for number in range(len(recording)):
        frame = recording[number]
        yield number, replace(frame, depth=_with_holes(np.asarray(frame.depth), number)) if holes else frame


def _with_holes(depth: Float[np.ndarray, "h w"], number: int) -> Float[np.ndarray, "h w"]:
    """Depth without half of its pixels: smooth patches, drawn by the number of the frame."""
    coarse = np.random.default_rng(number).normal(size=(8, 10)).astype(np.float32)
    field = cv2.resize(coarse, depth.shape[::-1], interpolation=cv2.INTER_CUBIC)
    return np.where(field > np.median(field), depth, 0)


class _Rows:
    """Prints a row of the table after each part of a run."""

    def __init__(self, part: int, frames: int) -> None:
        self._part, self._frames, self._total = part, frames, 0.0
        self._ms: list[float] = []
        print("| frames | keyframes | edges | Gaussians | mean, ms | 95 %, ms | longest, ms | lost | MB |")
        print("|---|---|---|---|---|---|---|---|---|", flush=True)

    def __call__(self, progress: slam.Progress) -> None:
        total = progress.run.stopwatch.total("frame")
        self._ms.append(1e3 * (total - self._total))
        self._total = total
        if progress.done % self._part and progress.done != self._frames:
            return
        state, ms = progress.run.state, np.asarray(self._ms)
        cells = (
            progress.done,
            len(state.graph.keyframes),
            len(state.graph.edges),
            progress.num_gaussians,
            f"{ms.mean():.1f}",
            f"{np.percentile(ms, 95):.1f}",
            f"{ms.max():.0f}",
            state.num_lost,
            _own_megabytes(),
        )
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
        self._ms.clear()


def _own_megabytes() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon")) >> 10


def _summary(state: slam.SlamState, truth: Trajectory) -> str:
    ate = evaluation.ate(state.trajectory, truth)
    path = np.linalg.norm(np.diff(truth.positions, axis=0), axis=1).sum()
    errors = _edge_errors(state, truth.poses)
    wrong = (errors[:, 0] > _WRONG_METRES) | (errors[:, 1] > _WRONG_RADIANS)
    return (
        f"\n{state.num_lost} frames lost; "
        f"ATE {100 * ate.rmse_m:.2f} cm, {100 * ate.rmse_m / path:.3f} % of {path:.0f} m; "
        f"{len(state.graph.loops)} edges to earlier keyframes; {wrong.sum()} of {len(wrong)} edges wrong"
    )


def _edge_errors(state: slam.SlamState, truth: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "e 2"]:
    """Error of each edge's motion, metres and radians."""
    graph = state.graph
    frames = np.asarray([keyframe.frame for keyframe in graph.keyframes])
    if not graph.edges:
        return np.zeros((0, 2))
    ends = frames[np.asarray([(edge.target, edge.source) for edge in graph.edges])]
    found = se3.matrices_of(np.stack([edge.T_target_source for edge in graph.edges]))
    true = np.linalg.inv(truth[ends[:, 0]]) @ truth[ends[:, 1]]
    off = se3.logs_of(np.linalg.inv(true) @ found)
    return np.stack([np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(off[:, 3:], axis=1)], axis=1)


if __name__ == "__main__":
    main()
