"""The driver: runs the steps over a source of frames and keeps what they found."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from sfgs_jax.geometry import Camera, Frame, FrameError, InputError, Trajectory
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.mapper import Mapper
from sfgs_jax.slam.mapping import follow_keyframes, optimise_once
from sfgs_jax.slam.state import SlamState, init
from sfgs_jax.slam.step import StepInfo, follow, step
from sfgs_jax.slam.stopwatch import Stopwatch
from sfgs_jax.slam.storage import load, save, saved_facts, spill
from sfgs_jax.splatting import Gaussians

Frames = Iterable[tuple[int, Frame | FrameError]]


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
        num_frames: frames that were offered, those that could not be decoded included.
        num_skipped: frames that could not be decoded.
        num_dropped: frames that came while another was being tracked, in real time.
        num_refined: optimisation steps done after the last frame.
        interrupted: whether it was ended before its source was.
        stopwatch: times of its stages.
    """

    config: SlamConfig
    state: SlamState
    num_frames: int = 0
    num_skipped: int = 0
    num_dropped: int = 0
    num_refined: int = 0
    interrupted: bool = False
    stopwatch: Stopwatch = field(default_factory=Stopwatch)

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the tracked frames, by where the graph has their keyframes now."""
        return self.state.trajectory

    @property
    def keyframe_trajectory(self) -> Trajectory:
        """Poses of the frames that the map was made from."""
        views = sorted(view.frame for view in self.state.mapping.views)
        return self.trajectory[self.state.log.positions(views)]

    @property
    def gaussians(self) -> Gaussians:
        """The map."""
        return self.state.gaussians


class TooManySkipped(InputError):
    """Too many frames could not be decoded.

    Attributes:
        run: what was found before.
    """

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


def save_run(run: Run, folder: Path | str) -> None:
    """Write a run, to go on with after `load_run`. Arguments and errors as of `save`."""
    save(
        run.state,
        folder,
        num_frames=run.num_frames,
        num_skipped=run.num_skipped,
        num_dropped=run.num_dropped,
        num_refined=run.num_refined,
    )


def load_run(folder: Path | str, config: SlamConfig) -> Run:
    """A run that was saved; its stopwatch starts anew. Arguments and errors as of `load`."""
    facts = saved_facts(folder)
    return Run(
        config,
        load(folder, config),
        num_frames=facts["num_frames"],
        num_skipped=facts["num_skipped"],
        num_dropped=facts["num_dropped"],
        num_refined=facts["num_refined"],
    )


def _ignore(progress: Progress) -> None:
    pass


def run(
    frames: Frames,
    camera: Camera,
    config: SlamConfig,
    *,
    observer: Callable[[Progress], None] = _ignore,
    storage: Path | None = None,
    resumed: Run | None = None,
    realtime: bool = False,
) -> Run:
    """Track and map a source of frames.

    An interruption (KeyboardInterrupt) ends the run early; what it found is returned all the same.

    Args:
        frames: numbers and frames, or the error of a frame that could not be decoded.
        camera: intrinsics of the frames.
        config: settings.
        observer: called after every frame and final step.
        storage: folder for the images of old keyframes; without one they stay in memory.
        resumed: a run to go on with; `frames` begin where it stopped.
        realtime: map in a thread of its own, in what time tracking leaves. Otherwise each frame and
            each view has its number of mapping steps, and a run repeats itself to the bit.

    Raises:
        TooManySkipped: too many frames could not be decoded; it carries the run so far.
    """
    result = resumed or Run(config, init(camera, config))
    if realtime:
        # The recording's clock starts with its first frame, and does not wait for a compiler.
        _rehearse(camera, config)
    mapper = Mapper(result.state, result.stopwatch, storage=storage) if realtime else None
    try:
        for number, frame in mapper.yielding(frames) if mapper else frames:
            info = _advance(result, number, frame, mapper)
            if storage is not None:
                result.state = spill(result.state, storage)
            skipped = frame if isinstance(frame, FrameError) else None
            mapping = mapper.mapping if mapper else result.state.mapping
            observer(Progress("frames", result.num_frames, mapping.num_gaussians, skipped, info, result))
            _check_skipped(result)
        _end_mapping(result, mapper)
        _refine(result, observer)
    except KeyboardInterrupt:
        result.interrupted = True
        _end_mapping(result, mapper)
    except BaseException:
        if mapper is not None:
            mapper.stop()
        raise
    return result


def _rehearse(camera: Camera, config: SlamConfig) -> None:
    """A step on two frames of noise, for nothing but the programs that it compiles."""
    rng = np.random.default_rng(0)
    rgb = rng.random((*camera.shape, 3), np.float32)
    state = init(camera, config)
    for timestamp in (0.0, 1.0):
        state, _ = step(state, Frame(rgb, np.full(camera.shape, 2.0, np.float32), timestamp))


def _advance(run: Run, number: int, frame: Frame | FrameError, mapper: Mapper | None) -> StepInfo | None:
    state, info = run.state, None
    if not isinstance(frame, FrameError):
        # The state numbers frames as the source does.
        state = replace(state, num_frames=number)
        with run.stopwatch("frame"):
            if mapper is None:
                state, info = step(state, frame, stages=run.stopwatch)
            else:
                state, info, view = follow(state, frame, stages=run.stopwatch)
                if info.tracked:
                    mapper.learn(state, view)
    # All at once, so that an interruption finds the frame either done or not begun. Numbers that were left
    # out are frames that came too fast.
    run.state = state
    run.num_skipped += info is None
    run.num_dropped += number - run.num_frames
    run.num_frames = number + 1
    return info


def _end_mapping(run: Run, mapper: Mapper | None) -> None:
    """The state with what the mapper has, and the map where the keyframes are."""
    if mapper is not None:
        run.state = replace(run.state, mapping=mapper.stop())
    if run.state.keyframes:
        mapping = follow_keyframes(run.state.mapping, run.state.keyframe_poses)
        run.state = replace(run.state, mapping=mapping)


def _refine(run: Run, observer: Callable[[Progress], None]) -> None:
    state, config = run.state, run.config
    if not state.mapping.views:
        return
    while run.num_refined < config.mapping.final_steps:
        with run.stopwatch("refinement"):
            mapping, _ = optimise_once(
                run.state.mapping, state.mapping_camera, config.mapping, newest_share=0.0, seed=config.seed
            )
        run.state = replace(run.state, mapping=mapping)
        run.num_refined += 1
        observer(Progress("refinement", run.num_refined, mapping.num_gaussians, None, None, run))


def _check_skipped(run: Run) -> None:
    limit = run.config.max_skipped_fraction
    if run.num_skipped > max(4, limit * run.num_frames):
        raise TooManySkipped(
            f"{run.num_skipped} of {run.num_frames} frames could not be decoded, more than the share "
            f"{limit:g} that max_skipped_fraction allows: the recording is damaged or not what it seems.",
            run,
        )
