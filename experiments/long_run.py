"""A long run: time of a frame, memory and keyframes by parts of the run, then the error and wrong edges.

    python -m experiments.long_run synthetic:place=building,frames=10000

A camera that stays in a place should cost the same in the last part as in the second, in time and in memory.
The map is left out, so that the figures are those of tracking and the graph; `--map` takes it in.
"""

import argparse
import resource
import time
from pathlib import Path

import numpy as np
from jaxtyping import Float

from sfgs_jax import datasets, evaluation, slam
from sfgs_jax.geometry import se3

_WRONG_METRES, _WRONG_RADIANS = 0.1, 0.1
"""Error of an edge's motion beyond which it is wrong."""


def main() -> None:
    """Run, and print a row for each part as it ends."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("source", help="recording with ground truth")
    parser.add_argument("--part", type=int, default=1000, help="frames of a row")
    parser.add_argument("--map", action="store_true", help="build the map too")
    options = parser.parse_args()
    recording = datasets.open_recording(options.source)
    advance = slam.step if options.map else slam.follow
    state, seconds = slam.init(recording.camera), []
    print("| frames | keyframes | edges | mean, ms | 95 %, ms | longest, ms | lost | memory, MB |")
    print("|---|---|---|---|---|---|---|---|")
    for number in range(len(recording)):
        frame = recording[number]
        start = time.perf_counter()
        state, *_ = advance(state, frame)
        seconds.append(time.perf_counter() - start)
        if (number + 1) % options.part == 0 or number + 1 == len(recording):
            print(_row(state, 1e3 * np.asarray(seconds[-options.part :]), number + 1), flush=True)
    state = slam.finish(state)
    assert recording.ground_truth is not None
    ate = evaluation.ate(state.trajectory, recording.ground_truth)
    path = np.linalg.norm(np.diff(recording.ground_truth.positions, axis=0), axis=1).sum()
    errors = _edge_errors(state, recording.ground_truth.poses)
    wrong = (errors[:, 0] > _WRONG_METRES) | (errors[:, 1] > _WRONG_RADIANS)
    print(
        f"\nATE {100 * ate.rmse_m:.2f} cm, {100 * ate.rmse_m / path:.3f} % of {path:.0f} m; "
        f"{len(state.graph.loops)} edges to earlier keyframes; {wrong.sum()} of {len(wrong)} edges wrong; "
        f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024} MB"
    )


def _row(state: slam.SlamState, ms: Float[np.ndarray, " n"], frames: int) -> str:
    cells = (
        frames,
        len(state.graph.keyframes),
        len(state.graph.edges),
        f"{ms.mean():.1f}",
        f"{np.percentile(ms, 95):.1f}",
        f"{ms.max():.0f}",
        state.num_lost,
        _resident_megabytes(),
    )
    return f"| {' | '.join(map(str, cells))} |"


def _resident_megabytes() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() >> 20


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
