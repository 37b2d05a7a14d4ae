"""`sfgs-jax view`: a run's map in the browser."""

import dataclasses
from pathlib import Path
from typing import Literal

import tyro

from sfgs_jax.arrays import InputError, check_counts, check_range, enable_cache
from sfgs_jax.cli._log import logger


@dataclasses.dataclass(frozen=True)
class ViewArguments:
    """Show a finished run, or a file of Gaussians, points or a mesh, in the browser."""

    path: tyro.conf.Positional[Path]
    """Folder that `sfgs-jax run` wrote, or a .ply, .splat, .spz or .glb file."""
    port: int = 8080
    """Port of the web server. The next free port is taken if it is in use; 0 takes any free one."""
    host: str = "127.0.0.1"
    """Address to listen on. The default lets this machine alone look. `0.0.0.0` lets other machines look,
    without any password."""
    open: bool = False
    """Open the page in the browser of this machine."""
    max_gaussians: int = 300_000
    """Most Gaussians that the browser draws. A larger map is drawn as a sample, and the page says so."""
    drawn_by: Literal["browser", "library"] = "browser"
    """Drawer of the map at first; the page can change it. The choice `library` sends images of all Gaussians,
    for browsers without a graphics card and for slow connections."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, 65535, "port")
        check_counts(self, 1, "max_gaussians")


def view_command(arguments: list[str]) -> int:
    """Run the command; see ViewArguments."""
    options = tyro.cli(ViewArguments, prog="sfgs-jax view", args=arguments)
    # The web server is imported only where it is needed.
    from sfgs_jax.splatting import contents_of
    from sfgs_jax.viewer import view_model, view_run

    if options.path.is_file() and contents_of(options.path) != "splats":
        view_model(options.path, port=options.port, host=options.host, open_browser=options.open)
        return 0

    try:
        enable_cache()
    except InputError as error:
        logger.warning("%s", error)
    view_run(
        options.path,
        port=options.port,
        host=options.host,
        max_gaussians=options.max_gaussians,
        drawn_by=options.drawn_by,
        open_browser=options.open,
    )
    return 0
