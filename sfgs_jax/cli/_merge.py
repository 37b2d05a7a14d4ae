"""`sfgs-jax merge`: the maps of two runs become one, with the poses of both in one world."""

import dataclasses
import json
import math
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import tyro

from sfgs_jax.arrays import InputError, check_range, enable_cache, sync_folder, write_atomically
from sfgs_jax.cli._configuration import RunConfig, read_config, to_json
from sfgs_jax.cli._log import logger
from sfgs_jax.cli._progress import Reporter, reporting
from sfgs_jax.cli._summary import summary
from sfgs_jax.slam import (
    GROUND_TRUTH_FILE,
    STORAGE,
    Progress,
    Run,
    kept_map,
    load_run,
    locked_folder,
    merge,
    prepare_folder,
    refine,
    save_run,
    write_run,
)


@dataclasses.dataclass(frozen=True)
class MergeArguments:
    """Merge the maps of two runs of one camera, which have a place in common, in one world."""

    first: tyro.conf.Positional[Path]
    """Folder of a run whose map was kept; its world is that of the result."""
    second: tyro.conf.Positional[Path]
    """Folder of another run whose map was kept, by the same camera in the same place."""
    out: Path
    """New folder for the result."""
    refine: float | None = None
    """Seconds in which to refine the merged map. None leaves it as the two runs had it."""
    quiet: bool = False
    """Print nothing but errors."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        if self.refine is not None:
            check_range(self, 0, math.inf, "refine")


def merge_command(arguments: list[str]) -> int:
    """Run the command; see MergeArguments."""
    options = tyro.cli(MergeArguments, prog="sfgs-jax merge", args=arguments)
    if os.path.realpath(options.first) == os.path.realpath(options.second):
        raise InputError(f"Both runs are {options.first}: give the folders of two runs.")
    (config, first), (_, second) = (_kept(folder) for folder in (options.first, options.second))
    try:
        enable_cache()
    except InputError as error:
        logger.warning("%s Every start compiles anew.", error)
    with _new_folder(options.out) as folder, reporting(quiet=options.quiet) as report:
        report("merging, run", 1, 2)
        result = _merged(first, second)
        report("merging, run", 2, 2)
        if options.refine:
            result = _refined(result, options.refine, report)
        metrics = _write(result, config, options, folder)
    if dropped := result.state.mapping.dropped_seeds:
        logger.warning("the maps were full: %d Gaussians had no room (max_capacity)", dropped)
    if not options.quiet:
        print(summary(metrics, options.out))
    return 0


def _kept(folder: Path) -> tuple[RunConfig, Run]:
    """Configuration and end of a run.

    Raises:
        InputError: it was not kept, or is of another version.
    """
    storage = kept_map(folder)
    config = read_config(folder / "config.json")
    return config, load_run(storage, config.slam)


@contextmanager
def _new_folder(out: Path) -> Iterator[Path]:
    """A folder that has its name once all is written, and is gone if that fails.

    Raises:
        InputError: there is one of that name, or it can't be made.
    """
    if out.exists():
        raise InputError(f"{out} exists: choose another folder with --out.")
    unfinished = out.with_name(f".{out.name}.unfinished")
    with locked_folder(unfinished):
        try:
            prepare_folder(unfinished, overwrite=True)
            yield unfinished
            unfinished.rename(out)
            sync_folder(out.parent)
        except BaseException:
            shutil.rmtree(unfinished, ignore_errors=True)
            raise


def _merged(first: Run, second: Run) -> Run:
    """Both runs as one whose frames have ended, and whose map is still to be refined."""
    return Run(
        merge(first.state, second.state),
        num_frames=first.num_frames + second.num_frames,
        num_skipped=first.num_skipped + second.num_skipped,
        num_dropped=first.num_dropped + second.num_dropped,
        is_finished=True,
    )


def _refined(result: Run, seconds: float, report: Reporter) -> Run:
    """The run after that much time of refinement, which is one of its settings from now on."""
    config = result.config
    config = dataclasses.replace(config, mapping=dataclasses.replace(config.mapping, final_seconds=seconds))
    result.advance(state=dataclasses.replace(result.state, config=config))
    total = math.ceil(seconds)

    def observe(progress: Progress) -> None:
        report("refining the map, second", min(progress.run.refinement_ms // 1000, total), total)

    refine(result, observe)
    return result


def _write(result: Run, config: RunConfig, options: MergeArguments, folder: Path) -> dict[str, object]:
    """Write the files of a run, and its state for later ones; returns the content of `metrics.json`.

    The settings name the first recording, whose images `view`, `export` and `eval` look up.
    """
    config = dataclasses.replace(config, slam=result.config)
    write_atomically(folder / "config.json", to_json(config))
    truth = options.first / GROUND_TRUTH_FILE
    if truth.is_file():
        write_atomically(folder / GROUND_TRUTH_FILE, truth.read_bytes())
    write_run(result, folder)
    metrics = json.loads((folder / "metrics.json").read_text())
    # No frame was tracked, so that there is no speed to tell.
    del metrics["fps"]
    metrics["merged"] = [str(path.resolve()) for path in (options.first, options.second)]
    write_atomically(folder / "metrics.json", json.dumps(metrics, indent=2) + "\n")
    save_run(result, folder / STORAGE)
    return metrics
