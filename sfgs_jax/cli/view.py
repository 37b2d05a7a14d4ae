"""`sfgs-jax view`: a run's map in the browser."""

import dataclasses
from pathlib import Path

import tyro

from sfgs_jax.viewer import view_run


@dataclasses.dataclass(frozen=True)
class ViewArguments:
    """Show the map of a run, or a splat PLY file, in the browser."""

    path: tyro.conf.Positional[Path]
    """Folder that `sfgs-jax run` wrote, or a .ply file in the layout of 3DGS."""
    port: int = 8080
    """Port of the local web server."""


def view_command(arguments: list[str]) -> int:
    """Run the command; see ViewArguments."""
    options = tyro.cli(ViewArguments, prog="sfgs-jax view", args=arguments)
    view_run(options.path, port=options.port)
    return 0
