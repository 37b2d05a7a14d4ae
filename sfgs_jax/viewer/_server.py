"""Start of a viser server, and what a command does with it."""

import contextlib
import io
import threading
import webbrowser
from collections.abc import Callable
from pathlib import Path

import viser

_LOCAL = ("127.0.0.1", "localhost", "::1")


def start_server(host: str, port: int, title: str) -> viser.ViserServer:
    """A server without the table that viser prints about each.

    Args:
        host: address to listen on.
        port: port to listen on; the next free one is taken if it is in use.
        title: of the browser's tab.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label=title, verbose=False)


def page_address(server: viser.ViserServer) -> str:
    """Address of a server's page on this machine."""
    host = server.get_host()
    listens_everywhere = host == "0.0.0.0"  # noqa: S104
    return f"http://{'127.0.0.1' if listens_everywhere else host}:{server.get_port()}"


def embedded(url: str) -> str:
    """HTML that shows a page in a notebook's cell."""
    return f'<iframe src="{url}" width="100%" height="600" style="border: none"></iframe>'


class Page:
    """A page that a server shows; it shows itself in notebooks.

    Args:
        server: of the page.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.server = server

    @property
    def url(self) -> str:
        """Address of the page on this machine."""
        return page_address(self.server)

    def _repr_html_(self) -> str:
        """The page in a notebook's cell."""
        return embedded(self.url)


def announce(path: Path, url: str, host: str, *, open_browser: bool) -> None:
    """Print where the page is and who can open it, and open it if that is wanted.

    Args:
        path: what is shown.
        url: address of the page.
        host: address that the server listens on.
        open_browser: open the page in the browser of this machine.
    """
    who = (
        "this machine alone can open it"
        if host in _LOCAL
        else "other machines can open it, without a password"
    )
    print(f"{path} is at {url} ({who}; Ctrl-C ends)", flush=True)
    if open_browser:
        webbrowser.open(url)


def wait_for_interrupt(close: Callable[[], None]) -> None:
    """Wait for Ctrl-C, then close.

    Args:
        close: stops the server.
    """
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        pass
    finally:
        close()
