"""One run of an ablation: a variant of the system on one start of a recording, and its figures."""

import csv
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import get_type_hints

import numpy as np
from jaxtyping import Float

from experiments.held_out import HeldOut
from sfgs_jax import slam
from sfgs_jax.arrays import FrameError, InputError
from sfgs_jax.datasets import Recording, prefetch
from sfgs_jax.evaluation import ate, rpe
from sfgs_jax.geometry import Trajectory
from sfgs_jax.slam import SlamConfig, SlamState, finish, follow, init

Key = tuple[str, int, int, int, str]


@dataclass(frozen=True)
class Run:
    """Figures of one run; those that cannot be had are NaN.

    Attributes:
        recording: name of the recording.
        frames: its number of frames, before the choice of a start and a stride.
        stride: frames from one selected frame to the next.
        start: number of the start; odd ones run backward.
        variant: name of the variant.
        tracked: share of the selected frames that have a pose.
        ate_m: RMSE after SE(3) alignment, metres.
        rpe_frame_m: RMSE of the motion to the next selected frame, metres.
        rpe_frame_deg: the same of its rotation, degrees.
        rpe_second_m: RMSE of the motion over one second, to the nearest selected frame, metres.
        rpe_second_deg: the same of its rotation, degrees.
        scale: factor on the estimate that fits the ground truth best, by Sim(3).
        surface_m: median distance between surfaces of frames far apart in time, metres.
        reprojection_px: median miss of held-out matches, pixels.
        keyframes: number of keyframes.
        loops: number of closed loops.
    """

    recording: str
    frames: int
    stride: int
    start: int
    variant: str
    tracked: float
    ate_m: float
    rpe_frame_m: float
    rpe_frame_deg: float
    rpe_second_m: float
    rpe_second_deg: float
    scale: float
    surface_m: float
    reprojection_px: float
    keyframes: int
    loops: int

    @property
    def key(self) -> Key:
        """Recording, frames, stride, start and variant: two runs with one key are the same."""
        return self.recording, self.frames, self.stride, self.start, self.variant


TYPES = get_type_hints(Run)


def read_runs(path: Path) -> list[Run]:
    """The runs in a file; none if there is no file."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        return [
            Run(**{name: TYPES[name](text) for name, text in row.items()}) for row in csv.DictReader(file)
        ]


def append_run(path: Path, run: Run) -> None:
    """Add a run to a file, which begins with the names of its columns."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.DictWriter(file, list(TYPES))
        if new:
            writer.writeheader()
        writer.writerow(asdict(run))


def tracked_poses(recording: Recording, config: SlamConfig) -> tuple[Float[np.ndarray, "n 4 4"], SlamState]:
    """Track a recording without a map; gives (N, 4, 4) poses, NaN for lost frames, and the last state."""
    state, tracked = init(recording.camera, config), []
    for index, frame in prefetch(recording):
        if not isinstance(frame, FrameError):
            state, info, _ = follow(state, frame)
            tracked += [index] if info.tracked else []
    state = finish(state)
    poses = np.full((len(recording), 4, 4), np.nan)
    largest = slam.Run(state).maps[0]
    poses[np.asarray(tracked, int)[largest.rows]] = largest.trajectory.poses
    return poses, state


def errors(recording: Recording, poses: Float[np.ndarray, "n 4 4"]) -> dict[str, float]:
    """Figures of poses (N, 4, 4), NaN for lost frames, against the ground truth; names as of `Run`."""
    names = ("ate_m", "scale", "rpe_frame_m", "rpe_frame_deg", "rpe_second_m", "rpe_second_deg")
    figures: dict[str, float] = dict.fromkeys(names, np.nan)
    truth, times = recording.ground_truth, recording.timestamps
    if truth is None or len(times) < 2:
        return figures
    has_pose = np.isfinite(poses).all((1, 2))
    found = Trajectory(times[has_pose], poses[has_pose])
    # Errors that need more poses than there are stay unknown.
    with suppress(InputError):
        figures["ate_m"] = ate(found, truth).rmse_m
        figures["scale"] = ate(found, truth, with_scale=True).alignment.scale
    second = max(1, round(1 / float(np.median(np.diff(times)))))
    for name, delta in (("frame", 1), ("second", second)):
        with suppress(InputError):
            relative = rpe(found, truth, delta=delta)
            figures |= {f"rpe_{name}_m": relative.trans_m, f"rpe_{name}_deg": relative.rot_deg}
    return figures


def measure(recording: Recording, held_out: HeldOut, config: SlamConfig, key: Key) -> Run:
    """Track one start with one variant and take its figures.

    Args:
        recording: the start.
        held_out: of this start.
        config: of the variant.
        key: names of both.
    """
    poses, state = tracked_poses(recording, config)
    return Run(
        *key,
        tracked=float(np.isfinite(poses).all((1, 2)).mean()),
        **errors(recording, poses),
        surface_m=held_out.surface_m(poses),
        reprojection_px=held_out.reprojection_px(poses),
        keyframes=len(state.graph.keyframes),
        loops=len(state.graph.loops),
    )
