"""`sfgs-jax run`: track and map a recording, write its results, evaluate them."""

import dataclasses
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Annotated, Literal

import tyro

from sfgs_jax.cli.cache import enable_compilation_cache
from sfgs_jax.cli.configuration import RunConfig, read_config, to_json
from sfgs_jax.cli.evaluate import evaluate_folder
from sfgs_jax.cli.log import logger, logging_to
from sfgs_jax.cli.progress import Reporter, reporting
from sfgs_jax.datasets import LAYOUTS, ReaderOptions, Recording, open_recording, play, prefetch
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import InputError, write_atomically
from sfgs_jax.slam import (
    PRESETS,
    STORAGE,
    Progress,
    Run,
    SlamConfig,
    TooManySkipped,
    load_run,
    prepare_folder,
    run,
    save_run,
    write_run,
    write_trajectories,
)

CHECKPOINT_FRAMES = 100
ERROR_FRAMES = 20


@dataclasses.dataclass(frozen=True)
class RunArguments:
    """Track and map a recording."""

    source: tyro.conf.Positional[str]
    """Folder of the recording, or the built-in room: `synthetic` or `synthetic:frames=60,width=160`."""
    out: Path | None = None
    """Folder for the results; runs/NAME if not given."""
    dataset: str | None = None
    """Layout of the recording, if not to be recognised: tum, 7scenes, replica, icl_nuim, scannet, folder."""
    config: Path | None = None
    """A config.json of an earlier run whose settings are taken."""
    overwrite: bool = False
    """Replace the results of an earlier run in the output folder."""
    resume: bool = False
    """Go on with the run in the output folder where it was stopped."""
    realtime: bool = False
    """Play the recording by its own clock, with mapping in what time tracking leaves; frames that come while
    another is tracked are dropped."""
    no_factor_graph: bool = False
    """Ablation: keyframes stay where they were tracked (--graph.no-enabled)."""
    no_loops: bool = False
    """Ablation: no loop is closed (--graph.no-loops)."""
    features: Literal["superfeats", "orb", "none"] | None = None
    """Ablation: which keypoints, `none` for GICP alone (--tracking.features.kind)."""
    no_gicp: bool = False
    """Ablation: keypoints alone (--tracking.no-use-surface)."""
    evaluate: bool = True
    """Compute image metrics and write the report after the run."""
    quiet: bool = False
    """Print nothing but errors."""
    reader: ReaderOptions = dataclasses.field(default_factory=ReaderOptions)
    """How the recording is read."""
    slam: Annotated[SlamConfig, tyro.conf.arg(name="")] = dataclasses.field(default_factory=SlamConfig)
    """Settings of the system; the defaults are the preset of the recording's layout."""


def run_command(arguments: list[str]) -> int:
    """Run the command; see RunArguments."""
    options, recording = _open(arguments)
    options = dataclasses.replace(options, slam=_with_switches(options))
    folder = options.out or Path("runs") / recording.name
    if not options.resume:
        prepare_folder(folder, overwrite=options.overwrite)
    enable_compilation_cache()
    with logging_to(folder / "run.log"):
        return _run(options, recording, folder)


def _open(arguments: list[str]) -> tuple[RunArguments, Recording]:
    """Parse the arguments twice: the recording's layout, or a given file, decides what the defaults are."""
    options = _parse(arguments, RunArguments(source=""))
    if options.dataset is not None and options.dataset not in LAYOUTS:
        raise InputError(f"There is no layout {options.dataset!r}; choose from {', '.join(LAYOUTS)}.")
    if options.config is not None:
        saved = read_config(options.config)
        defaults = RunArguments(source="", dataset=saved.dataset, reader=saved.reader, slam=saved.slam)
        options = _parse(arguments, defaults)
        return options, open_recording(options.source, dataset=options.dataset, options=options.reader)
    recording = open_recording(options.source, dataset=options.dataset, options=options.reader)
    return _parse(arguments, RunArguments(source="", slam=PRESETS[recording.dataset])), recording


def _with_switches(options: RunArguments) -> SlamConfig:
    """The settings with the ablations' short names applied."""
    slam = options.slam
    features, graph = slam.tracking.features, slam.graph
    tracking = dataclasses.replace(
        slam.tracking,
        features=dataclasses.replace(features, kind=options.features or features.kind),
        use_surface=slam.tracking.use_surface and not options.no_gicp,
    )
    if tracking.features.kind == "none" and not tracking.use_surface:
        raise InputError("Without features and without GICP nothing is left to track with.")
    graph = dataclasses.replace(
        graph,
        enabled=graph.enabled and not options.no_factor_graph,
        loops=graph.loops and not options.no_loops,
    )
    return dataclasses.replace(slam, tracking=tracking, graph=graph)


def _parse(arguments: list[str], defaults: RunArguments) -> RunArguments:
    return tyro.cli(RunArguments, prog="sfgs-jax run", args=arguments, default=defaults)


def _run(options: RunArguments, recording: Recording, folder: Path) -> int:
    config = RunConfig(_absolute(options.source), recording.dataset, options.reader, options.slam)
    storage = folder / STORAGE
    resumed = _resumed(folder, storage, config) if options.resume else None
    write_atomically(folder / "config.json", to_json(config))
    for note in recording.notes:
        logger.warning(note)
    logger.info("%s: %d frames of %dx%d", recording.name, len(recording), *recording.camera.shape[::-1])

    failure: TooManySkipped | None = None
    first = resumed.num_frames if resumed else 0
    if first:
        logger.info("going on after frame %d", first - 1)
    frames = play(recording, first=first) if options.realtime else prefetch(recording, first=first)
    with reporting("frames", len(recording), quiet=options.quiet) as report:
        watch = _Watcher(report, recording, folder, keep_state=not options.realtime)
        try:
            result = run(
                frames,
                recording.camera,
                options.slam,
                observer=watch,
                storage=storage,
                resumed=resumed,
                realtime=options.realtime,
            )
        except TooManySkipped as error:
            failure, result = error, error.run
    if result.interrupted and not options.realtime:
        watch.keep(result)
    written = _save(result, folder)
    if failure is not None:
        logger.error("%s", failure)
    if result.interrupted:
        print(
            f"Interrupted after {result.num_frames} frames; what there is lies in {written}"
            + ("." if options.realtime else ", and --resume goes on from there."),
            file=sys.stderr,
        )
        return 130
    if not len(result.trajectory):
        raise InputError(f"No frame of {recording.name} could be used; {folder / 'run.log'} says why.")
    if written == folder:
        shutil.rmtree(storage, ignore_errors=True)
    if options.evaluate:
        metrics = evaluate_folder(written, recording, quiet=options.quiet)
        if not options.quiet:
            print(_summary(metrics, written))
    return 1 if failure is not None or written != folder else 0


def _resumed(folder: Path, storage: Path, config: RunConfig) -> Run:
    """The run that was stopped.

    Raises:
        InputError: there is none, or it had other settings.
    """
    if not storage.is_dir():
        raise InputError(f"{folder} holds no run that could be resumed: it has ended, or never began.")
    if to_json(read_config(folder / "config.json")) != to_json(config):
        raise InputError(
            f"The run in {folder} was started with other settings; pass --config {folder / 'config.json'}."
        )
    return load_run(storage, config.slam)


class _Watcher:
    """Follows a run: logs what went wrong, shows progress, keeps trajectory and state on disk."""

    def __init__(self, report: Reporter, recording: Recording, folder: Path, *, keep_state: bool) -> None:
        self._report, self._recording, self._folder = report, recording, folder
        self._keep_state = keep_state
        self._error = ""

    def __call__(self, progress: Progress) -> None:
        result = progress.run
        if progress.stage != "frames":
            self._report(result.num_frames, f"refining the map, step {progress.done}")
            return
        if progress.skipped is not None:
            logger.warning("frame %d skipped: %s", result.num_frames - 1, progress.skipped)
        elif progress.info is not None and not progress.info.tracked:
            logger.warning(
                "frame %d lost: %d matches, %.0f %% of its surface fits",
                result.num_frames - 1,
                progress.info.num_inliers,
                100 * progress.info.inlier_fraction,
            )
        elif progress.info is not None and progress.info.relocalised:
            logger.info("frame %d found again", result.num_frames - 1)
        if progress.info is not None and progress.info.loop_closed:
            logger.info("frame %d closed a loop", result.num_frames - 1)
        if progress.done % ERROR_FRAMES == 0 and self._recording.ground_truth is not None:
            self._error = self._running_error(result)
        rate = progress.done / result.stopwatch.elapsed
        self._report(progress.done, f"{rate:.1f} frames/s, {progress.num_gaussians} Gaussians{self._error}")
        if progress.done % CHECKPOINT_FRAMES == 0:
            self.keep(result)

    def keep(self, result: Run) -> None:
        """Write what there is so far; that it can't be written ends no run."""
        try:
            write_trajectories(result, self._folder)
            if self._keep_state:
                save_run(result, self._folder / STORAGE)
        except OSError as error:
            logger.warning("what there is so far could not be written: %s", error)

    def _running_error(self, result: Run) -> str:
        truth = self._recording.ground_truth
        try:
            return f", ATE {100 * ate(result.trajectory, truth).rmse_m:.1f} cm" if truth is not None else ""
        except InputError:
            return ""


def _save(result: Run, folder: Path) -> Path:
    """Write the results; where the folder no longer takes them, write them where there is room."""
    if dropped := result.state.mapping.dropped_seeds:
        logger.warning("the map was full: %d Gaussians had no room (max_capacity)", dropped)
    try:
        write_run(result, folder)
        return folder
    except OSError as error:
        refuge = Path(tempfile.mkdtemp(prefix="sfgs-jax-"))
        logger.error("%s could not be written (%s): the results are in %s", folder, error.strerror, refuge)
        write_run(result, refuge)
        shutil.copy(folder / "config.json", refuge)
        return refuge


def _absolute(source: str) -> str:
    path = Path(source)
    return str(path.resolve()) if path.exists() else source


def _summary(metrics: dict, folder: Path) -> str:
    """A few lines for whoever waited."""
    frames = metrics["frames"]
    lines = [
        f"{frames['tracked']} of {frames['total']} frames tracked, {frames['keyframes']} keyframes, "
        f"{metrics['map']['gaussians']} Gaussians, {metrics['fps']['frames']} frames/s "
        f"({metrics['fps']['overall']} with compilation and refinement)",
    ]
    if "ate" in metrics:
        lines.append(f"ATE RMSE {100 * metrics['ate']['rmse_m']:.2f} cm")
    if "psnr" in metrics:
        lines.append(
            f"PSNR {metrics['psnr']['all']:.2f} dB, SSIM {metrics['ssim']['all']:.3f} over "
            f"{metrics['evaluated']['frames']['all']} frames, every pixel"
        )
    lines += [f"no {name}: {reason}" for name, reason in metrics.get("unavailable", {}).items()]
    lines += [
        f"report: {folder / 'report.html'}",
        f"look at the map: sfgs-jax view {folder}",
    ]
    return "\n".join(lines)
