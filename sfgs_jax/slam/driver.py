"""The driver: runs the steps over a source of frames and keeps what they found."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import jax
import numpy as np

from sfgs_jax.geometry import Camera, Frame, FrameError, InputError, Trajectory, se3
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.state import SlamState, init
from sfgs_jax.slam.step import StepInfo, optimise_once, step
from sfgs_jax.slam.stopwatch import Stopwatch
from sfgs_jax.splatting import Gaussians


@dataclass
class Progress:
    """What an observer is told after every frame, and once after each final optimisation step.

    Attributes:
        stage: "frames" or "refinement".
        done: frames or steps so far.
        num_gaussians: size of the map.
        skipped: the frame's error, if it could not be decoded.
        info: what the step did, if there was one.
        run: the run so far.
    """

    stage: str
    done: int
    num_gaussians: int
    skipped: FrameError | None
    info: StepInfo | None
    run: "Run"


@dataclass
class Run:
    """A run so far: what the output files are made from.

    Attributes:
        config: its settings.
        state: the state after the newest frame.
        timestamps: seconds, of every tracked frame.
        poses: (4, 4) `T_world_cam` of every tracked frame.
        keyframes: positions in `timestamps` of the mapping keyframes.
        num_frames: frames that were offered.
        num_skipped: frames that could not be decoded.
        num_lost: frames that could not be tracked.
        dropped_seeds: Gaussians for which the map had no room.
        interrupted: whether it was ended before its source was.
        stopwatch: times of its stages.
    """

    config: SlamConfig
    state: SlamState
    timestamps: list[float] = field(default_factory=list)
    poses: list[np.ndarray] = field(default_factory=list)
    keyframes: list[int] = field(default_factory=list)
    num_frames: int = 0
    num_skipped: int = 0
    num_lost: int = 0
    dropped_seeds: int = 0
    interrupted: bool = False
    stopwatch: Stopwatch = field(default_factory=Stopwatch)

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the tracked frames."""
        return Trajectory(np.asarray(self.timestamps, np.float64), np.asarray(self.poses).reshape(-1, 4, 4))

    @property
    def keyframe_trajectory(self) -> Trajectory:
        """Poses of the mapping keyframes."""
        return self.trajectory[np.asarray(self.keyframes, int)]

    @property
    def gaussians(self) -> Gaussians:
        """The map."""
        return self.state.map.gaussians


class TooManySkipped(InputError):
    """Too many frames could not be decoded.

    Attributes:
        run: what was found before.
    """

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


def _ignore(progress: Progress) -> None:
    pass


def run(
    frames: Iterable[tuple[int, Frame | FrameError]],
    camera: Camera,
    config: SlamConfig,
    *,
    observer: Callable[[Progress], None] = _ignore,
) -> Run:
    """Track and map a source of frames.

    An interruption (KeyboardInterrupt) ends the run early; what it found is returned all the same.

    Args:
        frames: numbers and frames, or the error of a frame that could not be decoded.
        camera: intrinsics of the frames.
        config: settings.
        observer: called after every frame and final step.

    Raises:
        TooManySkipped: too many frames could not be decoded; it carries the run so far.
    """
    result = Run(config, init(camera, config))
    try:
        for _, frame in frames:
            info = _advance(result, frame)
            skipped = frame if isinstance(frame, FrameError) else None
            observer(Progress("frames", result.num_frames, result.state.num_gaussians, skipped, info, result))
            _check_skipped(result)
        _refine(result, observer)
    except KeyboardInterrupt:
        result.interrupted = True
    return result


def _advance(run: Run, frame: Frame | FrameError) -> StepInfo | None:
    run.num_frames += 1
    if isinstance(frame, FrameError):
        run.num_skipped += 1
        return None
    with run.stopwatch("frame"):
        run.state, info = step(run.state, frame, stages=run.stopwatch)
    run.dropped_seeds += info.dropped_seeds
    if not info.tracked:
        run.num_lost += 1
        return info
    if info.new_keyframe:
        run.keyframes.append(len(run.timestamps))
    run.timestamps.append(float(frame.timestamp))
    run.poses.append(se3.to_matrices(jax.tree.map(lambda x: x[None], info.T_world_cam))[0])
    return info


def _refine(run: Run, observer: Callable[[Progress], None]) -> None:
    if not run.state.keyframes:
        return
    for done in range(run.config.mapping.final_steps):
        with run.stopwatch("refinement"):
            run.state, _ = optimise_once(run.state)
        observer(Progress("refinement", done + 1, run.state.num_gaussians, None, None, run))


def _check_skipped(run: Run) -> None:
    limit = run.config.max_skipped_fraction
    if run.num_skipped > max(4, limit * run.num_frames):
        raise TooManySkipped(
            f"{run.num_skipped} of {run.num_frames} frames could not be decoded, more than the share "
            f"{limit:g} that max_skipped_fraction allows: the recording is damaged or not what it seems.",
            run,
        )
