"""Synthetic places that are hard: a long loop, two rooms that look the same, a bare wall, a bare sphere.

    python -m experiments.places [--places ring twins wall sphere] [--seeds 0]

320x240 with the noise of a Kinect, tracking without a map. The columns:

- tracked: frames that have a pose.
- ATE, worst: RMSE and largest error of the final poses in the largest map, after SE(3) alignment.
- off in the keyframe: largest error of a pose in its keyframe as it was given. Behind it, how many are above
  5 cm.
- end: error of the motion from the recording's start to its end, which a loop has to close.
- false loops: those off by more than 0.3 m or 10 degrees from the truth.
"""

import argparse
from dataclasses import replace

import numpy as np
from rich.progress import track

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import SyntheticRecording, prefetch
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import se3
from sfgs_jax.slam import Run, SlamConfig, SlamState, finish, follow, init

FRAMES = {"ring": 1000, "twins": 600, "wall": 300, "sphere": 400}
WITH_LOOPS = SlamConfig()
WITHOUT = replace(WITH_LOOPS, graph=replace(WITH_LOOPS.graph, loops=False))
MARGIN_METRES, MARGIN_DEGREES = 0.3, 10.0
WRONG_METRES = 0.05
"""Error of a pose in its keyframe beyond which it is counted."""


def angle(T: np.ndarray) -> float:
    """Of a motion's rotation, degrees."""
    return float(np.rad2deg(np.arccos(np.clip((np.trace(T[:3, :3]) - 1) / 2, -1, 1))))


def false_loops(state: SlamState, truth: np.ndarray) -> int:
    """Number of closed loops that join two different places."""
    false = 0
    for edge in state.graph.loops:
        a, b = (truth[state.graph.keyframes[k].frame] for k in (edge.target, edge.source))
        off = np.linalg.inv(np.linalg.inv(a) @ b) @ se3.matrices_of(edge.T_target_source[None])[0]
        false += bool(np.linalg.norm(off[:3, 3]) > MARGIN_METRES or angle(off) > MARGIN_DEGREES)
    return false


def error_in_keyframe(state: SlamState, truth: np.ndarray) -> float:
    """Error of the newest frame's position in its keyframe, metres."""
    log = state.log
    keyframe = state.graph.keyframes[int(log.keyframes[-1])].frame
    true = np.linalg.inv(truth[keyframe]) @ truth[log.newest]
    return float(np.linalg.norm(log.motions[-1, 4:] - true[:3, 3]))


def measure(place: str, seed: int, config: SlamConfig, name: str) -> tuple[str, ...]:
    """Track a place and give its row of the table."""
    recording = SyntheticRecording(num_frames=FRAMES[place], noise=True, seed=seed, place=place)
    state, truth, given = init(recording.camera, config), recording.ground_truth, []
    for number, frame in track(prefetch(recording), description=name, total=len(recording), transient=True):
        if isinstance(frame, FrameError):
            continue
        state, info, _ = follow(state, frame, number=number)
        if info.tracked:
            given.append(error_in_keyframe(state, truth.poses))
    run = Run(finish(state))
    found, graph = run.maps[0].trajectory, run.state.graph
    error = ate(found, truth)
    matrices = truth.poses[np.searchsorted(truth.timestamps, found.timestamps - 1e-6)]
    end = np.linalg.inv(matrices[0]) @ matrices[-1]
    moved = np.linalg.inv(found.poses[0]) @ found.poses[-1]
    return (
        name,
        str(seed),
        f"{len(given)} / {len(recording)}",
        str(len(run.maps)),
        f"{100 * error.rmse_m:.1f}",
        f"{100 * error.max_m:.1f}",
        f"{100 * max(given):.1f}, {sum(off > WRONG_METRES for off in given)}",
        f"{100 * np.linalg.norm(end[:3, 3] - moved[:3, 3]):.1f}",
        str(len(graph.keyframes)),
        f"{len(graph.loops)} / {false_loops(run.state, truth.poses)}",
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--places", nargs="+", default=list(FRAMES), choices=list(FRAMES))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    arguments = parser.parse_args()
    header = ("place", "seed", "tracked", "maps", "ATE cm", "worst cm", "off in the keyframe cm, above 5")
    header += ("end cm", "keyframes", "loops / false")
    rows: list[tuple[str, ...]] = [header, tuple("---" for _ in header)]
    for place in arguments.places:
        for seed in arguments.seeds:
            rows.append(measure(place, seed, WITH_LOOPS, place))
            if place == "ring":
                rows.append(measure(place, seed, WITHOUT, "ring without loops"))
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
