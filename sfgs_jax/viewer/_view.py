"""A finished run, or a file of Gaussians, in the browser."""

from pathlib import Path

from sfgs_jax.viewer._finished_run import open_finished_run
from sfgs_jax.viewer._scene import MOST_GAUSSIANS, MapScene
from sfgs_jax.viewer._server import announce, start_server, wait_for_interrupt
from sfgs_jax.viewer._server_rendering import Drawer
from sfgs_jax.viewer._splats import splats_of


def view_run(
    path: Path | str,
    *,
    port: int = 8080,
    host: str = "127.0.0.1",
    max_gaussians: int = MOST_GAUSSIANS,
    drawn_by: Drawer = "browser",
    open_browser: bool = False,
    block: bool = True,
) -> MapScene:
    """Show a finished run in the browser: its map, its path, and its recorded images beside rendered ones.

    Prints the address of the page. In a notebook the result of `block=False` shows the page in its cell.

    Args:
        path: folder that a run wrote; or a .ply, .splat, .spz or .glb file, which is shown without a path.
        port: port to listen on; the next free one is taken if it is in use, and 0 takes any free one.
        host: address to listen on; "0.0.0.0" lets other machines look, without any password.
        max_gaussians: Gaussians that the browser draws at most; a larger map is drawn as a sample.
        drawn_by: who draws the map at first: the browser, or the library, which sends images of all of it.
        open_browser: open the page in the browser of this machine.
        block: wait for Ctrl-C, stop the server, and return then.

    Returns:
        The scene; without `block` it is live until its `close`.

    Raises:
        InputError: there is no map, or a file is damaged.
    """
    path = Path(path)
    run = open_finished_run(path)
    server = start_server(host, port, f"sfgs-jax · {run.name}")
    scene = MapScene(
        server,
        splats_of(run.gaussians),
        run.trajectory,
        run.keyframes,
        gaussians=run.gaussians,
        camera=run.camera,
        covariances=run.covariances,
        frames=run.frames,
        notes=run.notes,
        max_gaussians=max_gaussians,
        drawn_by=drawn_by,
    )
    for note in run.notes:
        print(note, flush=True)
    announce(path, scene.url, host, open_browser=open_browser)
    if block:
        wait_for_interrupt(scene.close)
    return scene
