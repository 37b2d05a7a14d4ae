"""`sfgs-jax run`: track and map a recording, write its results, evaluate them."""

import dataclasses
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import tyro

from sfgs_jax.cli.cache import enable_compilation_cache
from sfgs_jax.cli.configuration import RunConfig, read_config, to_json
from sfgs_jax.cli.evaluate import evaluate_folder
from sfgs_jax.cli.log import logger, logging_to
from sfgs_jax.cli.progress import Reporter, reporting
from sfgs_jax.datasets import LAYOUTS, ReaderOptions, Recording, open_recording, prefetch
from sfgs_jax.evaluation import ate
from sfgs_jax.geometry import InputError, write_atomically
from sfgs_jax.slam import (
    PRESETS,
    Progress,
    Run,
    SlamConfig,
    TooManySkipped,
    prepare_folder,
    run,
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
    folder = options.out or Path("runs") / recording.name
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


def _parse(arguments: list[str], defaults: RunArguments) -> RunArguments:
    return tyro.cli(RunArguments, prog="sfgs-jax run", args=arguments, default=defaults)


def _run(options: RunArguments, recording: Recording, folder: Path) -> int:
    config = RunConfig(_absolute(options.source), recording.dataset, options.reader, options.slam)
    write_atomically(folder / "config.json", to_json(config))
    for note in recording.notes:
        logger.warning(note)
    logger.info("%s: %d frames of %dx%d", recording.name, len(recording), *recording.camera.shape[::-1])

    failure: TooManySkipped | None = None
    with reporting("frames", len(recording), quiet=options.quiet) as report:
        watch = _Watcher(report, recording, folder)
        try:
            result = run(prefetch(recording), recording.camera, options.slam, observer=watch)
        except TooManySkipped as error:
            failure, result = error, error.run
    written = _save(result, folder)
    if failure is not None:
        logger.error("%s", failure)
    if result.interrupted:
        print(
            f"Interrupted after {result.num_frames} frames; what there is lies in {written}.", file=sys.stderr
        )
        return 130
    if not result.timestamps:
        raise InputError(f"No frame of {recording.name} could be used; {folder / 'run.log'} says why.")
    if options.evaluate:
        metrics = evaluate_folder(written, recording, quiet=options.quiet)
        if not options.quiet:
            print(_summary(metrics, written))
    return 1 if failure is not None or written != folder else 0


class _Watcher:
    """Follows a run: logs what went wrong, shows progress, keeps the trajectory on disk."""

    def __init__(self, report: Reporter, recording: Recording, folder: Path) -> None:
        self._report, self._recording, self._folder = report, recording, folder
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
                "frame %d lost: %.0f %% of it matched",
                result.num_frames - 1,
                100 * progress.info.inlier_fraction,
            )
        if progress.done % ERROR_FRAMES == 0 and self._recording.ground_truth is not None:
            self._error = self._running_error(result)
        rate = progress.done / result.stopwatch.elapsed
        self._report(progress.done, f"{rate:.1f} frames/s, {progress.num_gaussians} Gaussians{self._error}")
        if progress.done % CHECKPOINT_FRAMES == 0:
            self._checkpoint(result)

    def _checkpoint(self, result: Run) -> None:
        try:
            write_trajectories(result, self._folder)
        except OSError as error:
            logger.warning("the trajectory so far could not be written: %s", error)

    def _running_error(self, result: Run) -> str:
        truth = self._recording.ground_truth
        try:
            return f", ATE {100 * ate(result.trajectory, truth).rmse_m:.1f} cm" if truth is not None else ""
        except InputError:
            return ""


def _save(result: Run, folder: Path) -> Path:
    """Write the results; where the folder no longer takes them, write them where there is room."""
    if result.dropped_seeds:
        logger.warning("the map was full: %d Gaussians had no room (max_capacity)", result.dropped_seeds)
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
        f"{metrics['map']['gaussians']} Gaussians, {metrics['fps']['overall']} frames/s overall "
        f"({metrics['fps']['tracking']} tracking)",
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
