"""Results of a run on disk: in its folder, or in another one where that no longer takes them."""

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path

from sfgs_jax.arrays import make_folder, write_atomically
from sfgs_jax.cli._configuration import RunConfig, to_json
from sfgs_jax.cli._log import logger
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import format_tum
from sfgs_jax.slam import GROUND_TRUTH_FILE, STORAGE, Run, save_run, write_run

_CONFIG_FILE = "config.json"


@dataclass(frozen=True)
class ResultFolder:
    """The folder of a run: what it begins with, and what it ends with.

    Attributes:
        path: of the folder.
        config: settings of the run.
        recording: its recording.
    """

    path: Path
    config: RunConfig
    recording: Recording

    def begin(self) -> None:
        """Write the settings and the recorded poses; the folder is made if it is not there.

        Raises:
            OSError: they can't be written.
        """
        make_folder(self.path)
        truth = self.recording.ground_truth
        if truth is not None:
            write_atomically(self.path / GROUND_TRUTH_FILE, format_tum(truth))
        write_atomically(self.path / _CONFIG_FILE, to_json(self.config))

    def restore(self) -> None:
        """Begin again if somebody has removed the folder in mid-run.

        Raises:
            OSError: it can't be made again.
        """
        if not (self.path / _CONFIG_FILE).exists():
            self.begin()
            logger.warning("%s was removed while the run went on: it has been made again", self.path)

    def write(self, result: Run) -> Path:
        """Write the results; if the folder no longer takes them, write them where there is room.

        Args:
            result: the run at its end.

        Returns:
            The folder that holds the results.

        Raises:
            OSError: neither takes them; the error names both.
        """
        try:
            self.restore()
            write_run(result, self.path)
            return self.path
        except OSError as error:
            refuge = ResultFolder(Path(tempfile.mkdtemp(prefix="sfgs-jax-")), self.config, self.recording)
            try:
                refuge.begin()
                write_run(result, refuge.path)
            except OSError as other:
                other.filename = f"neither {self.path} nor {refuge.path} takes the results"
                raise
            logger.error(
                "%s could not be written (%s): the results are in %s", self.path, error.strerror, refuge.path
            )
            return refuge.path


def kept_to_resume(result: Run, written: Path) -> bool:
    """Keep an interrupted run beside its results, for `--resume` to go on from there.

    Args:
        result: the run.
        written: folder of its results.

    Returns:
        Whether that could be done.
    """
    with contextlib.suppress(OSError):
        save_run(result, written / STORAGE)
        return True
    return False
