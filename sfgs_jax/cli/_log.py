"""The log: warnings on the console, everything in the run's `run.log`."""

import contextlib
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import WatchedFileHandler
from pathlib import Path

logger = logging.getLogger("sfgs_jax")


class _QuietFile(WatchedFileHandler):
    """A log file whose failure (a full disk) never ends the run or floods the console.

    It is opened again if it was removed.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record; where there is no folder any more it is lost."""
        with contextlib.suppress(OSError):
            super().emit(record)

    def handleError(self, record: logging.LogRecord) -> None:
        """Lose the record."""


@contextmanager
def logging_to(path: Path) -> Iterator[None]:
    """Log to `path`, and warnings to the console as well."""
    file = _QuietFile(path)
    file.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(message)s"))
    console = logging.StreamHandler(sys.stderr)
    console.setLevel(logging.WARNING)
    console.setFormatter(logging.Formatter("%(levelname)s: %(message)s"))
    handlers = (file, console)
    logger.setLevel(logging.INFO)
    for handler in handlers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for handler in handlers:
            logger.removeHandler(handler)
            handler.close()
