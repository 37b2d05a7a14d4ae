"""The driver: runs the steps over a source of frames and keeps what they found."""

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import (
    FrameError,
    InputError,
    Text,
    checked,
    excerpt,
    one_blas_thread,
    printed_fields,
    return_free_memory,
    short_turns,
)
from sfgs_jax.geometry import Camera, Frame, Trajectory, same_camera
from sfgs_jax.sensors import SensorModel
from sfgs_jax.slam._graph_results import finish
from sfgs_jax.slam._init import init
from sfgs_jax.slam.config import SlamConfig
from sfgs_jax.slam.keyframes import Registrations, with_pairs_of_known_motion
from sfgs_jax.slam.mapping import (
    InlineMapWorker,
    MapWorker,
    ThreadedMapWorker,
    follow_keyframes,
    follow_trajectory,
    in_the_mean_exposure,
    prepare_refinement,
    refine_once,
)
from sfgs_jax.slam.run._finished_maps import FinishedMap, maps_of_run
from sfgs_jax.slam.run._stopwatch import Stopwatch
from sfgs_jax.slam.run._storage import load, remove_other_images, save, saved_facts, spill, spill_views
from sfgs_jax.slam.run._warm_up import warm_up
from sfgs_jax.slam.state import MapState, SlamState, StepInfo, trajectory_of
from sfgs_jax.slam.step import follow
from sfgs_jax.splatting import Gaussians

_T = TypeVar("_T")
_TRIM_EVERY = 128
"""Frames after which free memory is given back; compilation leaves hundreds of megabytes."""
Frames = Iterable[tuple[int, Frame | FrameError]]


@dataclass
class Progress:
    """Report to an observer after every frame and every final map step.

    Attributes:
        stage: "frames" or "refinement".
        done: frames or steps so far.
        num_gaussians: size of the map.
        skipped: the frame's error, if it could not be decoded.
        info: what the step did, if there was one.
        run: the run so far.
        frame: the newest frame, if it could be decoded; none after a final step.
    """

    stage: str
    done: int
    num_gaussians: int
    skipped: FrameError | None
    info: StepInfo | None
    run: "Run"
    frame: Frame | None = None


Observer = Callable[[Progress], None]
"""Follows a run, called in its thread. A KeyboardInterrupt that an observer raises ends the run early."""


def combined(*observers: Observer) -> Observer:
    """One observer out of several, called in this order.

    Args:
        observers: to be called.
    """

    def observe(progress: Progress) -> None:
        for observer in observers:
            observer(progress)

    return observe


@dataclass
class Run:
    """A run so far, from which the output files are made.

    Attributes:
        state: the state after the newest frame.
        num_frames: frames that were offered, those that could not be decoded included.
        num_skipped: frames that could not be decoded.
        num_dropped: frames that came while another was being tracked, in real time.
        num_refined: map steps done after the last frame.
        refinement_ms: time that they took, milliseconds.
        is_finished: whether its frames have ended, and keyframes and map are ready for the refinement.
        interrupted: whether it was ended before its source was.
        storage_failure: why the images of old keyframes and views stay in memory, if they could not be put on
            disk; empty without a failure.
        stopwatch: times of its stages.
    """

    state: SlamState
    num_frames: int = 0
    num_skipped: int = 0
    num_dropped: int = 0
    num_refined: int = 0
    refinement_ms: int = 0
    is_finished: bool = False
    interrupted: bool = False
    storage_failure: str = ""
    stopwatch: Stopwatch = field(default_factory=Stopwatch)

    def __repr__(self) -> str:
        return printed_fields(
            "Run", num_frames=self.num_frames, is_finished=self.is_finished, state=Text(repr(self.state))
        )

    def advance(self, **changes: Any) -> None:
        """Change several attributes at once: an interruption finds all of them changed, or none.

        Args:
            changes: new values by name.
        """
        # One call into C. Python handles signals between instructions, never inside of it.
        vars(self).update(changes)

    @property
    def config(self) -> SlamConfig:
        """Settings of the run."""
        return self.state.config

    @property
    def maps(self) -> tuple[FinishedMap, ...]:
        """Maps that nothing ties to each other, that of most frames first; most runs have one."""
        return maps_of_run(self.state)

    @property
    def trajectory(self) -> Trajectory:
        """Poses of the frames of the largest map, by where the graph has their keyframes now."""
        return self.maps[0].trajectory

    @property
    def covariances(self) -> Float[np.ndarray, "n 6 6"]:
        """Covariances of these poses: of tangents on the right, translation first, metres and radians."""
        return self.maps[0].covariances

    @property
    def keyframe_trajectory(self) -> Trajectory:
        """Poses of the frames that the largest map was made from."""
        return self.maps[0].keyframe_trajectory

    @property
    def gaussians(self) -> Gaussians:
        """The largest map."""
        return self.maps[0].gaussians

    @property
    def refined_share(self) -> float:
        """Share of the refinement that is done, by its time or by its steps."""
        config = self.config.mapping
        if config.final_seconds > 0:
            return self.refinement_ms / 1e3 / config.final_seconds
        return self.num_refined / config.final_steps if config.final_steps else 1.0


class TooManySkipped(InputError):
    """Too many frames could not be decoded.

    Attributes:
        run: what was found before.
    """

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


@checked
def save_run(run: Run, folder: Path | str) -> None:
    """Write a run, to go on with after `load_run`.

    Args:
        run: the run.
        folder: made if it is not there; it belongs to one run.

    Raises:
        OSError: a file can't be written.
    """
    save(
        run.state,
        folder,
        num_frames=run.num_frames,
        num_skipped=run.num_skipped,
        num_dropped=run.num_dropped,
        num_refined=run.num_refined,
        refinement_ms=run.refinement_ms,
        is_finished=int(run.is_finished),
    )


@checked
def load_run(folder: Path | str, config: SlamConfig, camera: Camera | None = None) -> Run:
    """A run that was saved; its stopwatch starts anew.

    Args:
        folder: where `save_run` wrote.
        config: settings of the run that was saved.
        camera: its camera, to make sure that it is the same; not compared if not given.

    Raises:
        InputError: as by `load`.
    """
    facts = saved_facts(folder)
    return Run(
        load(folder, config, camera),
        num_frames=facts["num_frames"],
        num_skipped=facts["num_skipped"],
        num_dropped=facts["num_dropped"],
        num_refined=facts["num_refined"],
        refinement_ms=facts["refinement_ms"],
        is_finished=bool(facts["is_finished"]),
    )


def _ignore(progress: Progress) -> None:
    pass


@checked
@one_blas_thread()
def run(
    frames: Frames,
    camera: Camera,
    config: SlamConfig,
    *,
    observer: Observer = _ignore,
    storage: Path | None = None,
    resumed: Run | None = None,
    realtime: bool = False,
    sensors: SensorModel | None = None,
) -> Run:
    """Track and map a source of frames.

    An interruption (KeyboardInterrupt) ends the run early; the result so far is returned all the same.

    Args:
        frames: numbers and frames, or the error of a frame that could not be decoded.
        camera: intrinsics of the frames.
        config: settings.
        observer: called after every frame and final step; `combined` makes one of several.
        storage: folder for the images of old keyframes and views, of this run alone: others are removed.
            Without one, or when it can't be written, they stay in memory.
        resumed: a run to go on with; `frames` begin where it stopped.
        realtime: map in a thread of its own, in the time that tracking leaves. Otherwise each frame and each
            view has its number of map steps, and a run repeats itself to the bit.
        sensors: what is known about the camera; see `init`. A resumed run knows it already.

    Raises:
        TooManySkipped: too many frames could not be decoded; it carries the run so far.
        InputError: the resumed run had another camera or other settings.
    """
    result = resumed or Run(init(camera, config, sensors))
    _check_resumed(result, camera, config)
    with result.stopwatch("compilation"):
        warm_up(camera, config)
    _stored(result, result.state, storage, _without_other_images)
    result.advance(state=_stored(result, result.state, storage, spill))
    worker = _map_worker(result, config, storage, realtime=realtime)
    registrations = Registrations(are_awaited=False) if realtime else None
    try:
        with short_turns():
            _follow_all(result, frames, worker, observer, storage, registrations)
        if not result.is_finished:
            _finish(result, worker)
        refine(result, observer)
    except KeyboardInterrupt:
        result.interrupted = True
        mapping = worker.stop()
        # A map in the run's own thread may be a frame ahead; the state has it as of its newest frame.
        if realtime and not result.is_finished:
            result.state = replace(result.state, mapping=_moved(mapping, result.state))
    except BaseException:
        worker.stop()
        raise
    return result


def _follow_all(
    result: Run,
    frames: Frames,
    worker: MapWorker,
    observer: Observer,
    storage: Path | None,
    registrations: Registrations | None,
) -> None:
    """The run after all frames of its source."""
    for number, frame in worker.frames(frames):
        if registrations is not None:
            registrations.frame_came()
        found = _advance(result, number, frame, worker, storage, registrations)
        observer(_progress(result, frame, found))
        _check_skipped(result)
        if result.num_frames % _TRIM_EVERY == 0:
            Thread(target=return_free_memory, name="sfgs_jax heap", daemon=True).start()
        if registrations is not None and isinstance(found, StepInfo) and found.tracked:
            params, graph = result.state.params, result.state.graph
            ready = with_pairs_of_known_motion(params, graph, result.state.log.newest)
            registrations.begin_while_idle(params, ready, result.config.graph)


def _map_worker(result: Run, config: SlamConfig, storage: Path | None, *, realtime: bool) -> MapWorker:
    """The owner of the map, which spills the images of views to the storage."""
    kept = config.mapping.views_in_memory

    def spill_map(mapping: MapState) -> MapState:
        return _stored(result, mapping, storage, lambda m, folder: spill_views(m, folder, kept))

    kind = ThreadedMapWorker if realtime else InlineMapWorker
    return kind(result.state, result.stopwatch, spill_map)


def _progress(result: Run, frame: Frame | FrameError, found: StepInfo | FrameError) -> Progress:
    """The state of the run for the observer, after a frame."""
    info, skipped = (None, found) if isinstance(found, FrameError) else (found, None)
    image = None if isinstance(frame, FrameError) else frame
    gaussians = result.state.mapping.num_gaussians
    return Progress("frames", result.num_frames, gaussians, skipped, info, result, image)


def _check_resumed(run: Run, camera: Camera, config: SlamConfig) -> None:
    if not same_camera(camera, run.state.camera):
        raise InputError("The run was started with another camera; resume it with that one.")
    if config != run.config:
        raise InputError("The run was started with other settings; resume it with those.")


def _advance(
    run: Run,
    number: int,
    frame: Frame | FrameError,
    worker: MapWorker,
    storage: Path | None,
    registrations: Registrations | None,
) -> StepInfo | FrameError:
    """The run after a frame, or after one that can't be used, whose error is returned."""
    state = run.state
    try:
        if isinstance(frame, FrameError):
            raise frame
        with run.stopwatch("frame"):
            state, found, view = follow(
                state, frame, number=number, stages=run.stopwatch, registrations=registrations
            )
            if found.tracked:
                found = found._replace(loss=worker.learn(state, view))
    except FrameError as error:
        found = error
    else:
        put = partial(spill, before=run.state)
        state = _stored(run, replace(state, mapping=worker.mapping), storage, put)
    # Numbers that were left out are frames that came too fast.
    run.advance(
        state=state,
        num_skipped=run.num_skipped + isinstance(found, FrameError),
        num_dropped=run.num_dropped + number - run.num_frames,
        num_frames=number + 1,
        is_finished=False,
    )
    return found


def _without_other_images(state: SlamState, storage: Path) -> SlamState:
    remove_other_images(state, storage)
    return state


def _stored(run: Run, value: _T, storage: Path | None, put: Callable[[_T, Path], _T]) -> _T:
    """A state whose old images are on disk; as it was without a folder, or if that can't be written."""
    if storage is None or run.storage_failure:
        return value
    try:
        return put(value, storage)
    except (OSError, InputError) as error:
        # A full disk may cost memory, but not the run.
        run.storage_failure = excerpt(error)
        return value


def _finish(run: Run, worker: MapWorker) -> None:
    """Adjust the keyframes after the last frame, and move the map and its views to where they are."""
    with run.stopwatch("graph"):
        state = finish(run.state)
    mapping = _moved(worker.stop(), state)
    if mapping.views:
        mapping = follow_trajectory(mapping, state.log, trajectory_of(state.log, state.graph))
        mapping = in_the_mean_exposure(mapping)
    run.advance(state=replace(state, mapping=mapping), is_finished=True)


def _moved(mapping: MapState, state: SlamState) -> MapState:
    """A map where the keyframes of a state are."""
    if not state.graph.keyframes:
        return mapping
    return follow_keyframes(mapping, state.graph.poses, state.row_times)


@checked
def refine(run: Run, observer: Observer = _ignore) -> None:
    """Refine the map by its views, for as long as the settings say: what a run does after its last frame.

    Args:
        run: whose frames have ended; what of the refinement is done already is not done again.
        observer: called after every step.
    """
    config = run.config
    if not run.state.mapping.views:
        return
    if config.mapping.final_seconds and run.refined_share < 1:
        with run.stopwatch("compilation"):
            state = run.state
            mapping = prepare_refinement(
                state.mapping, state.mapping_camera, config.mapping, seed=config.seed
            )
        run.advance(state=replace(state, mapping=mapping))
    while (done := run.refined_share) < 1:
        start = time.perf_counter()
        with run.stopwatch("refinement"):
            mapping, _ = refine_once(
                run.state.mapping,
                run.state.mapping_camera,
                config.mapping,
                number=run.num_refined,
                done=done,
                seed=config.seed,
            )
        run.advance(
            state=replace(run.state, mapping=mapping),
            num_refined=run.num_refined + 1,
            refinement_ms=run.refinement_ms + round(1e3 * (time.perf_counter() - start)),
        )
        observer(Progress("refinement", run.num_refined, mapping.num_gaussians, None, None, run))


def _check_skipped(run: Run) -> None:
    limit = run.config.max_skipped_fraction
    if run.num_skipped > max(4, limit * run.num_frames):
        raise TooManySkipped(
            f"{run.num_skipped} of {run.num_frames} frames could not be decoded, more than the share "
            f"{limit:g} that max_skipped_fraction allows: the recording is damaged or not what it seems.",
            run,
        )
