"""`sfgs-jax run`: track and map a recording, write its results, evaluate them."""

import dataclasses
import json
import math
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Protocol, runtime_checkable

import tyro

from sfgs_jax.arrays import FrameError, InputError, check_counts, check_range, enable_cache
from sfgs_jax.cli._ablations import Ablation, ablated
from sfgs_jax.cli._configuration import RunConfig, read_config, to_json
from sfgs_jax.cli._evaluate import evaluate_folder
from sfgs_jax.cli._interruption import end_if_interrupted
from sfgs_jax.cli._live import keep_page, live_view
from sfgs_jax.cli._log import logger, logging_to
from sfgs_jax.cli._outcome import failure_of, scale_warning
from sfgs_jax.cli._progress import reporting
from sfgs_jax.cli._results import ResultFolder, kept_to_resume
from sfgs_jax.cli._run_observer import RunObserver
from sfgs_jax.cli._short_help import short_help
from sfgs_jax.cli._summary import summary
from sfgs_jax.datasets import LAYOUTS, ReaderOptions, Recording, open_recording, play, prefetch
from sfgs_jax.geometry import Camera, Frame
from sfgs_jax.sensors import SensorModel, read_sensors
from sfgs_jax.slam import (
    PRESETS,
    STORAGE,
    Run,
    SlamConfig,
    TooManySkipped,
    combined,
    kept_map,
    load_run,
    locked_folder,
    new_session,
    prepare_folder,
    remove_storage,
    resume_folder,
    run,
    save_run,
)

if TYPE_CHECKING:
    from sfgs_jax.viewer import LiveView

_INTERRUPTED = 130
"""Exit status."""

_USAGE = """usage: sfgs-jax run SOURCE [--out DIR] [OPTIONS]

SOURCE is the folder or file of a recording, or the built-in room: sfgs-jax run synthetic"""
_HELP_ALL = "--help-all"
_SHOWN = (
    "out",
    "overwrite",
    "resume",
    "map",
    "keep-map",
    "view",
    "realtime",
    "refine",
    "no-evaluate",
    "quiet",
    "dataset",
    "reader.start",
    "reader.end",
    "reader.stride",
    "reader.camera",
    "reader.depth-scale",
    "reader.max-depth",
    "config",
    "sensors",
    "ablation",
    "mapping.max-width",
    "mapping.final-steps",
)
"""Options that most people need; `--help-all` shows the others."""
_EXAMPLES = (
    "sfgs-jax run synthetic:frames=60,width=160,height=120",
    "sfgs-jax check my_desk                              is the recording fit for a run?",
    "sfgs-jax run my_desk --view                         watch it in the browser",
    "sfgs-jax run my_desk --reader.stride 2 --overwrite  every second frame",
    "sfgs-jax run my_desk --resume                       go on where a run was stopped",
    "sfgs-jax run my_desk --out runs/b --config runs/my_desk/config.json",
    "sfgs-jax run my_desk --keep-map                     for another day's recording of the same place:",
    "sfgs-jax run my_desk_2 --map runs/my_desk",
)

_SOURCE_HELP = (
    "Folder or file of the recording, or the built-in room: `synthetic` or `synthetic:frames=60,width=160`."
)
_DATASET_HELP = f"Layout of the recording: {', '.join(LAYOUTS)}. None recognises it."


@runtime_checkable
class FrameSource(Protocol):
    """Gives the frames of a recording with their numbers, as `prefetch` and `play` do."""

    def __call__(self, recording: Recording, *, first: int) -> Iterator[tuple[int, Frame | FrameError]]:
        """Frames of a recording from the one numbered `first`."""
        ...


@dataclasses.dataclass(frozen=True)
class RunOptions:
    """Options of `sfgs-jax run`."""

    out: Path | None = None
    """Folder for the results. None means `runs/NAME`, with the name of the recording."""
    dataset: Annotated[str | None, tyro.conf.arg(help=_DATASET_HELP)] = None
    config: Path | None = None
    """A config.json of an earlier run; its settings become the defaults."""
    sensors: Path | None = None
    """A sensors.json of an earlier run with the same camera; the estimates begin with its values."""
    map: Path | None = None
    """Folder of a run with `--keep-map`; this run goes on in its map, with its settings."""
    keep_map: bool = False
    """Keep all that `--map` of a later run needs: keyframes and images, a few MB for each keyframe."""
    overwrite: bool = False
    """Replace the results of an earlier run in the output folder."""
    resume: bool = False
    """Go on with the run in the output folder where it was stopped."""
    checkpoint_interval: int = 100
    """Frames, or steps of the refinement, between two checkpoints that `--resume` can go on from."""
    realtime: bool = False
    """Play the recording by its own clock. Frames that come while another is tracked are dropped."""
    refine: float | None = None
    """Seconds in which to refine the map after the last frame, in place of a number of steps."""
    ablation: Ablation = "none"
    """Part of the system to leave out or to replace, on top of all other settings."""
    evaluate: bool = True
    """Compute image metrics and write the report after the run."""
    quiet: bool = False
    """Print nothing but errors."""
    view: bool = False
    """Show the run in the browser while it goes on; the address is printed."""
    view_port: int = 8080
    """Port of the page. The next free port is taken if it is in use."""
    view_host: str = "127.0.0.1"
    """Address that the page listens on. `0.0.0.0` lets other machines look, and stop the run."""
    reader: ReaderOptions = dataclasses.field(default_factory=ReaderOptions)
    """Units, intrinsics and choice of frames."""
    slam: Annotated[SlamConfig, tyro.conf.arg(name="")] = dataclasses.field(default_factory=SlamConfig)
    """Settings of the system; the defaults are the preset of the recording's layout."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 1, 65535, "view_port")
        check_counts(self, 1, "checkpoint_interval")
        if self.refine is not None:
            check_range(self, 0, math.inf, "refine")


def run_command(arguments: list[str], *, frames: FrameSource = prefetch) -> int:
    """Run the command.

    Args:
        arguments: words after `sfgs-jax run`.
        frames: source of the frames of a run that is not in real time.

    Returns:
        The exit status.
    """
    if not arguments:
        print(f"{_USAGE}\nMost options: sfgs-jax run --help", file=sys.stderr)
        return 2
    if not {"-h", "--help"}.isdisjoint(arguments):
        more = f"All settings of the system: sfgs-jax run {_HELP_ALL}"
        print(short_help(_USAGE, RunOptions, _SHOWN, _EXAMPLES, more))
        return 0
    arguments = ["--help" if word == _HELP_ALL else word for word in arguments]
    source, options, recording = _open(arguments)
    options = dataclasses.replace(
        options, slam=_refined(ablated(options.slam, options.ablation), options.refine)
    )
    known = read_sensors(options.sensors) if options.sensors is not None else None
    path = None if options.sensors is None else options.sensors.absolute()
    place = None if options.map is None else Path(os.path.realpath(options.map))
    config = RunConfig(_absolute(source), recording.dataset, options.reader, options.slam, path, place)
    folder = options.out or Path("runs") / recording.name
    if place is not None and place == Path(os.path.realpath(folder)):
        raise InputError(f"{folder} holds the map to go on in: choose another folder with --out.")
    # Before anything is overwritten: the map may be of another camera.
    begun = None if place is None or options.resume else _in_map(place, options.slam, recording.camera)
    frames = play if options.realtime else frames
    with locked_folder(folder, make=not options.resume):
        if options.resume:
            resume_folder(folder)
            # A map that was kept for another day stays.
            options = dataclasses.replace(options, keep_map=options.keep_map or _has_ended(folder))
        else:
            prepare_folder(folder, overwrite=options.overwrite)
        with logging_to(folder / "run.log"):
            resumed = _resumed(folder, config, recording.camera) if options.resume else begun
            out = ResultFolder(folder, config, recording)
            out.begin()
            what = (options, out, resumed, frames, known)
            if not options.view:
                return _run(*what, None)
            with live_view(recording, folder, host=options.view_host, port=options.view_port) as view:
                status = _run(*what, view)
                # After Ctrl-C nobody wants to wait.
                if status != _INTERRUPTED or view.control.stopped:
                    keep_page(view)
                return status


def _open(arguments: list[str]) -> tuple[str, RunOptions, Recording]:
    """Parse the arguments twice: the recording's layout, or a given file, decides what the defaults are."""
    source, options = parse_run(arguments, RunOptions())
    if options.config is not None:
        saved = read_config(options.config)
        defaults = RunOptions(
            dataset=saved.dataset,
            reader=saved.reader,
            slam=saved.slam,
            sensors=saved.sensors,
            map=saved.map,
        )
        source, options = parse_run(arguments, defaults)
        return source, options, open_recording(source, dataset=options.dataset, options=options.reader)
    recording = open_recording(source, dataset=options.dataset, options=options.reader)
    slam = PRESETS[recording.dataset] if options.map is None else _saved_config(options.map).slam
    source, options = parse_run(arguments, RunOptions(slam=slam))
    return source, options, recording


def _saved_config(folder: Path) -> RunConfig:
    """The configuration of the run whose map a folder holds.

    Raises:
        InputError: it holds none.
    """
    kept_map(folder)
    return read_config(folder / "config.json")


def parse_run(arguments: list[str], defaults: RunOptions) -> tuple[str, RunOptions]:
    """Source and options of a run.

    Args:
        arguments: words after `sfgs-jax run`.
        defaults: of the options.

    Raises:
        InputError: a value has no meaning.
        SystemExit: the words are not understood, which the standard error explains.
    """

    def parsed(
        source: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SOURCE", help=_SOURCE_HELP)],
        options: Annotated[RunOptions, tyro.conf.arg(name="")] = defaults,
    ) -> tuple[str, RunOptions]:
        """Track and map a recording."""
        return source, options

    return tyro.cli(parsed, prog="sfgs-jax run", args=arguments)


def _refined(config: SlamConfig, seconds: float | None) -> SlamConfig:
    if seconds is None:
        return config
    return dataclasses.replace(config, mapping=dataclasses.replace(config.mapping, final_seconds=seconds))


def _absolute(source: str) -> str:
    path = Path(source)
    return str(path.resolve()) if path.exists() else source


def _resumed(folder: Path, config: RunConfig, camera: Camera) -> Run:
    """The run that was stopped.

    Raises:
        InputError: it had other settings or another camera.
    """
    if to_json(read_config(folder / "config.json")) != to_json(config):
        raise InputError(
            f"The run in {folder} was started with other settings; pass --config {folder / 'config.json'}."
        )
    return load_run(folder / STORAGE, config.slam, camera)


def _has_ended(folder: Path) -> bool:
    """Whether the run in a folder came to its end."""
    try:
        return not json.loads((folder / "metrics.json").read_text())["frames"]["interrupted"]
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _in_map(folder: Path, config: SlamConfig, camera: Camera) -> Run:
    """A run that begins in the map of an earlier one.

    Raises:
        InputError: that has no map, another camera or other settings.
    """
    before = load_run(kept_map(folder), _saved_config(folder).slam, camera)
    return Run(new_session(before.state, config))


def _run(
    options: RunOptions,
    out: ResultFolder,
    resumed: Run | None,
    frames: FrameSource,
    sensors: SensorModel | None,
    view: "LiveView | None",
) -> int:
    """Run over the frames, write the results and evaluate them; returns the exit status."""
    folder, recording = out.path, out.recording
    _begin_log(recording, resumed)
    failure: TooManySkipped | None = None
    first = resumed.num_frames if resumed else 0
    with reporting(quiet=options.quiet) as report:
        observer = RunObserver(
            report,
            recording,
            folder,
            restore=out.restore,
            keep_state=not options.realtime,
            interval=options.checkpoint_interval,
        )
        observer.begin(first)
        try:
            result = run(
                frames(recording, first=first),
                recording.camera,
                out.config.slam,
                observer=combined(observer, *([] if view is None else [view]), end_if_interrupted),
                storage=folder / STORAGE,
                resumed=resumed,
                realtime=options.realtime,
                sensors=sensors,
            )
        except TooManySkipped as error:
            failure, result = error, error.run
    kept = result.interrupted and not options.realtime and observer.keep(result)
    if dropped := result.state.mapping.dropped_seeds:
        logger.warning("the map was full: %d Gaussians had no room (max_capacity)", dropped)
    written = out.write(result)
    if view is not None:
        view.finish(result, f"Results: {written}")
    if failure is not None:
        logger.error("%s", failure)
    if result.interrupted:
        if not options.realtime and not (kept and written == folder):
            kept = kept_to_resume(result, written)
        _say_interrupted(result, written, can_resume=kept, moved=written != folder)
        return _INTERRUPTED
    status = _closed(options, out, result, written, observer.contradiction)
    return 1 if failure is not None else status


def _closed(options: RunOptions, out: ResultFolder, result: Run, written: Path, contradiction: str) -> int:
    """Evaluate the results of a run that came to its end, and say what it came to; returns the exit status.

    Args:
        options: of the command.
        out: the folder that the results were meant for.
        result: the run.
        written: the folder that they are in.
        contradiction: why frames were not believed, if they were not.
    """
    folder, recording = out.path, out.recording
    if not len(result.trajectory):
        raise InputError(f"No frame of {recording.name} could be used; {folder / 'run.log'} says why.")
    if options.evaluate and not _evaluated(written, recording, quiet=options.quiet):
        return 1
    if written == folder:
        if options.keep_map:
            save_run(result, folder / STORAGE)
        else:
            remove_storage(folder)
    metrics = json.loads((written / "metrics.json").read_text())
    if not options.quiet:
        print(summary(metrics, written))
    if warning := scale_warning(result.trajectory, recording):
        logger.warning("%s", warning)
    first = int(result.state.log.numbers[0])
    confirming = min(first, result.config.graph.relocalisation_frames - 1) if out.config.map else 0
    if problem := failure_of(metrics, out.config.source, contradiction, confirming=confirming):
        logger.error("%s", problem)
    return 1 if problem is not None or written != folder else 0


def _begin_log(recording: Recording, resumed: Run | None) -> None:
    try:
        enable_cache()
    except InputError as error:
        logger.warning("%s Every start compiles anew.", error)
    for note in recording.notes:
        logger.warning(note)
    logger.info("%s: %d frames of %dx%d", recording.name, len(recording), *recording.camera.shape[::-1])
    if resumed is not None and resumed.num_frames:
        logger.info("going on after frame %d", resumed.num_frames - 1)


def _evaluated(written: Path, recording: Recording, *, quiet: bool) -> bool:
    """Evaluate the results. False, with the reason in the log, if that could not be written."""
    try:
        evaluate_folder(written, recording, quiet=quiet)
    except OSError as error:
        logger.error(
            "the evaluation could not be written (%s): `sfgs-jax eval %s` does it again", error, written
        )
        return False
    return True


def _say_interrupted(result: Run, written: Path, *, can_resume: bool, moved: bool) -> None:
    words = f"--resume --out {written}" if moved else "--resume"
    ending = f", and {words} goes on from there." if can_resume else "."
    print(
        f"Interrupted after {result.num_frames} frames; the results so far are in {written}{ending}",
        file=sys.stderr,
    )
