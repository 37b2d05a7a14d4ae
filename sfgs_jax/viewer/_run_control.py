"""Pause, step, stop and save: asked for in any thread, done in the run's own."""

import threading
from collections.abc import Callable

from sfgs_jax.slam import Run


class RunControl:
    """A gate that a run passes after every frame and final map step.

    `pause`, `resume`, `step`, `stop` and `save` return at once.

    Args:
        write: writes the results so far.
    """

    def __init__(self, write: Callable[[Run], None]) -> None:
        self._write = write
        self._changed = threading.Condition()
        self._paused = self._stopped = self._save_wanted = False
        self._steps = 0

    @property
    def paused(self) -> bool:
        """True if the run waits, or will after the frame in work."""
        return self._paused

    @property
    def stopped(self) -> bool:
        """True if the run was asked to end."""
        return self._stopped

    def pause(self) -> None:
        """Wait after the frame in work."""
        with self._changed:
            self._paused = True

    def resume(self) -> None:
        """Go on."""
        with self._changed:
            self._paused, self._steps = False, 0
            self._changed.notify()

    def step(self) -> None:
        """Do one frame more and wait after it; a run that was going waits after the frame in work."""
        with self._changed:
            self._steps += self._paused
            self._paused = True
            self._changed.notify()

    def stop(self) -> None:
        """End the run after the frame in work, as Ctrl-C does."""
        with self._changed:
            self._stopped = True
            self._changed.notify()

    def save(self) -> None:
        """Write the results after the frame in work."""
        with self._changed:
            self._save_wanted = True
            self._changed.notify()

    def pass_through(self, run: Run) -> None:
        """Return when the run may go on.

        Args:
            run: the run so far.

        Raises:
            KeyboardInterrupt: the run was asked to stop.
        """
        while True:
            with self._changed:
                self._changed.wait_for(self._may_go_on)
                if not self._save_wanted:
                    self._steps -= self._paused and not self._stopped
                    break
                self._save_wanted = False
            self._write(run)
        if self._stopped:
            raise KeyboardInterrupt

    def _may_go_on(self) -> bool:
        return self._stopped or self._save_wanted or not self._paused or self._steps > 0
