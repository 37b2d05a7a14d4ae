"""The page of a run that goes on: `sfgs-jax run --view`."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from sfgs_jax.datasets import Recording
from sfgs_jax.slam import write_run

if TYPE_CHECKING:
    from sfgs_jax.viewer import LiveView


@contextmanager
def live_view(recording: Recording, folder: Path, *, host: str, port: int) -> Iterator["LiveView"]:
    """Serve the page; its address is printed.

    Args:
        recording: of the run.
        folder: where the page's button writes the results so far.
        host: address to listen on.
        port: port to listen on, or the next free one.
    """
    # The web server is imported only where it is needed.
    from sfgs_jax.viewer import LiveView

    with LiveView(
        num_frames=len(recording),
        ground_truth=recording.ground_truth,
        save=lambda run: write_run(run, folder),
        name=recording.name,
        port=port,
        host=host,
    ) as view:
        print(f"{recording.name} can be watched at {view.address}", flush=True)
        yield view


def keep_page(view: "LiveView") -> None:
    """Serve the page of a run that has ended until nobody looks at it, or Ctrl-C.

    Args:
        view: of the run.
    """
    if not view.server.get_clients():
        return
    print(f"{view.address} stays until its last browser is closed, or Ctrl-C.", file=sys.stderr, flush=True)
    try:
        view.wait_for_browsers()
    except KeyboardInterrupt:
        return
