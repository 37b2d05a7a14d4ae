"""`sfgs-jax view`: a run's map in the browser."""

import dataclasses
from pathlib import Path

import tyro

from sfgs_jax.arrays import check_range


@dataclasses.dataclass(frozen=True)
class ViewArguments:
    """Show the map of a run, or a splat PLY file, in the browser."""

    path: tyro.conf.Positional[Path]
    """Folder that `sfgs-jax run` wrote, or a .ply file in the layout of 3DGS."""
    port: int = 8080
    """Port of the web server. The next free port is taken if it is in use."""
    host: str = "127.0.0.1"
    """Address to listen on. `0.0.0.0` lets other machines look, without any password."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 1, 65535, "port")


def view_command(arguments: list[str]) -> int:
    """Run the command; see ViewArguments."""
    options = tyro.cli(ViewArguments, prog="sfgs-jax view", args=arguments)
    # The web server is imported only where it is needed.
    from sfgs_jax.viewer import view_run

    view_run(options.path, port=options.port, host=options.host)
    return 0
