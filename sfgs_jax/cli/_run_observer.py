"""The command's view of a run: log, progress, and the trajectory and state kept on disk."""

import math
import time
from collections.abc import Callable
from pathlib import Path

from sfgs_jax.arrays import InputError
from sfgs_jax.cli._log import logger
from sfgs_jax.cli._progress import Reporter
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation import ate
from sfgs_jax.slam import STORAGE, Progress, Run, save_run, write_trajectories

_ERROR_FRAMES = 20

_FRAMES, _STEPS, _SECONDS = "frame", "refining the map, step", "refining the map, second"
"""Names of the tasks; the refinement counts steps or seconds."""


class RunObserver:
    """Follows a run: logs what went wrong, shows progress, keeps trajectory and state on disk.

    Args:
        report: shows progress.
        recording: the recording of the run.
        folder: the run's folder.
        restore: makes the folder again if it was removed; may raise OSError.
        keep_state: also keep the state that `--resume` needs.
        interval: frames, or steps of the refinement, between two checkpoints.

    Attributes:
        contradiction: why frames were not believed, as it was said last; empty if it never was.
    """

    def __init__(
        self,
        report: Reporter,
        recording: Recording,
        folder: Path,
        *,
        restore: Callable[[], None],
        keep_state: bool,
        interval: int,
    ) -> None:
        self._report, self._recording, self._folder = report, recording, folder
        self._restore, self._keep_state, self._interval = restore, keep_state, interval
        self._error, self._failure = "", ""
        self._said_storage_failure = self._contradicted = False
        self._start: tuple[int, float] | None = None
        self.contradiction = ""

    def begin(self, first: int) -> None:
        """Say that the run begins at frame `first`, and why nothing moves for a while."""
        details = "compiling (first run of this size, about a minute)"
        self._report(_FRAMES, first, len(self._recording), details)

    def __call__(self, progress: Progress) -> None:
        """Take note of a frame or of a final mapping step."""
        if progress.stage != "frames":
            self._refined(progress)
            return
        self._log(progress)
        if progress.done % _ERROR_FRAMES == 0 and self._recording.ground_truth is not None:
            self._error = self._running_error(progress.run)
        details = f"{self._rate(progress.done)}{progress.num_gaussians} Gaussians{self._error}"
        self._report(_FRAMES, progress.done, len(self._recording), details)
        if progress.done % self._interval == 0:
            self.keep(progress.run)

    def _refined(self, progress: Progress) -> None:
        config = progress.run.config.mapping
        if config.final_seconds > 0:
            seconds, total = progress.run.refinement_ms / 1e3, math.ceil(config.final_seconds)
            self._report(_SECONDS, min(int(seconds), total), total)
        else:
            self._report(_STEPS, progress.done, config.final_steps)
        if progress.done % self._interval == 0:
            self.keep(progress.run)

    def keep(self, run: Run) -> bool:
        """Write the results so far; a failure to write does not end the run.

        Returns:
            Whether `--resume` can go on from here.
        """
        try:
            self._restore()
            write_trajectories(run, self._folder)
            if self._keep_state:
                save_run(run, self._folder / STORAGE)
        except OSError as error:
            # Said once while it lasts.
            if str(error) != self._failure:
                logger.warning("the results so far could not be written: %s", error)
            self._failure = str(error)
            return False
        self._failure = ""
        return self._keep_state

    def _log(self, progress: Progress) -> None:
        number, info = progress.run.num_frames - 1, progress.info
        failure = progress.run.storage_failure
        if failure and not self._said_storage_failure:
            self._said_storage_failure = True
            logger.warning("images of old views stay in memory, for they could not be written: %s", failure)
        if progress.skipped is not None:
            logger.warning("frame %d skipped: %s", number, progress.skipped)
        elif info is not None and info.contradiction:
            self.contradiction = info.contradiction
            # Said once while it lasts.
            if not self._contradicted:
                logger.warning("frames are lost from %d on: %s", number, info.contradiction)
        elif info is not None and not info.tracked and _is_confirming(progress.run):
            logger.info("frame %d: its place in the map is not confirmed yet", number)
        elif info is not None and not info.tracked:
            share = 100 * info.inlier_fraction
            logger.warning(
                "frame %d lost: %d matches, %.0f %% of its surface fits", number, info.num_inliers, share
            )
        elif info is not None and info.relocalised:
            logger.info("frame %d found again", number)
        self._contradicted = info is not None and bool(info.contradiction)
        if info is not None and info.loop_closed:
            logger.info("frame %d closed a loop", number)

    def _rate(self, done: int) -> str:
        """Frames per second since the first frame was done, so that compilation does not count."""
        now = time.monotonic()
        if self._start is None:
            self._start = done, now
            return ""
        first, start = self._start
        return f"{(done - first) / max(now - start, 1e-9):.1f} frames/s, "

    def _running_error(self, run: Run) -> str:
        truth = self._recording.ground_truth
        try:
            return f", ATE {100 * ate(run.trajectory, truth).rmse_m:.1f} cm" if truth is not None else ""
        except InputError:
            return ""


def _is_confirming(run: Run) -> bool:
    """Whether a run that began in an earlier map may still be looking for its place there."""
    begun = bool(run.state.graph.keyframes) and not len(run.state.log.timestamps)
    return begun and run.num_frames < run.config.graph.relocalisation_frames
