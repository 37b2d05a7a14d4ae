"""Files that a browser asks for."""

import tempfile
import threading
from collections.abc import Callable
from pathlib import Path

import viser

from sfgs_jax.arrays import InputError
from sfgs_jax.viewer._controls import SaveControls
from sfgs_jax.viewer._latest import Latest

SaveView = Callable[[Path, viser.ClientHandle, int, int], None]
"""Writes an image of a browser's view: path, browser, width, height."""

SaveVideo = Callable[[Path, int, int, Callable[[float], bool]], bool]
"""Writes a video: path, width, height, and what is told the share that is done."""


class Downloads:
    """Makes files in a thread, one after the other, and gives them to the browser that asked.

    Args:
        controls: the buttons.
        save_view: writes the image of a view.
        save_video: writes a video; it tells whether it went to the end.
        save_map: writes the map in the format of the suffix.
    """

    def __init__(
        self,
        controls: SaveControls,
        save_view: SaveView,
        save_video: SaveVideo,
        save_map: Callable[[Path], None],
    ) -> None:
        self._controls = controls
        self._save_view, self._save_video, self._save_map = save_view, save_video, save_map
        self._work = Latest("downloads")
        self._stopped = threading.Event()
        controls.on_still(self._still)
        controls.on_video(self._video)
        controls.on_map(self._map)
        controls.on_stop(self._stopped.set)

    def close(self) -> None:
        """Stop a video that is being made, and the thread."""
        self._stopped.set()
        self._work.close()

    def _still(self, client: viser.ClientHandle) -> None:
        width, height = self._controls.size

        def write(path: Path) -> bool:
            self._save_view(path, client, width, height)
            return True

        self._give(client, "view.png", write)

    def _video(self, client: viser.ClientHandle) -> None:
        width, height = self._controls.size
        self._stopped.clear()

        def progress(share: float) -> bool:
            self._controls.show_progress(share)
            return not self._stopped.is_set()

        def write(path: Path) -> bool:
            try:
                progress(0)
                return self._save_video(path, width, height, progress)
            finally:
                self._controls.show_progress(None)

        self._give(client, "replay.mp4", write)

    def _map(self, client: viser.ClientHandle, suffix: str) -> None:
        def write(path: Path) -> bool:
            self._save_map(path)
            return True

        self._give(client, f"map.{suffix}", write)

    def _give(self, client: viser.ClientHandle, name: str, write: Callable[[Path], bool]) -> None:
        """Write a file and send it, or say why it can't be written."""

        def work() -> None:
            with tempfile.TemporaryDirectory(prefix="sfgs-jax-") as folder:
                path = Path(folder) / name
                try:
                    if write(path):
                        client.send_file_download(name, path.read_bytes(), save_immediately=True)
                except (InputError, OSError) as error:
                    client.add_notification(f"{name} was not saved", str(error), color="red")

        self._work.call(f"{client.client_id} {name}", work)
