"""Start of a viser server."""

import contextlib
import io

import viser


def start_server(host: str, port: int, title: str) -> viser.ViserServer:
    """A server without the table that viser prints about each.

    Args:
        host: address to listen on.
        port: port to listen on; the next free one is taken if it is in use.
        title: of the browser's tab.
    """
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label=title, verbose=False)
