"""A finished run, or a splat file, in the browser."""

import threading
from pathlib import Path

import numpy as np
import viser

from sfgs_jax.geometry import Trajectory, read_tum
from sfgs_jax.splatting import load_ply, map_file
from sfgs_jax.viewer._scene import MapScene
from sfgs_jax.viewer._splats import splats_of


def view_run(path: Path | str, *, port: int = 8080, host: str = "127.0.0.1", block: bool = True) -> MapScene:
    """Open the map of a run in viser: the Gaussians, the path with its keyframes, and a replay.

    Prints the address to open in a browser.

    Args:
        path: folder that a run wrote, or a .ply file in the layout of 3DGS, which is shown without a path.
        port: port to listen on; the next free one is taken if it is in use.
        host: address to listen on; "0.0.0.0" lets other machines look, without any password.
        block: wait for Ctrl-C, stop the server, and return then.

    Returns:
        The scene; without `block` it is live until its `close`.

    Raises:
        InputError: there is no map, or a file is damaged.
    """
    path = Path(path)
    splats = splats_of(load_ply(map_file(path)))
    nothing = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    trajectory, keyframes = (
        read_tum(path / name) if (path / name).is_file() else nothing
        for name in ("trajectory.txt", "keyframes.txt")
    )
    server = viser.ViserServer(host=host, port=port, label=f"sfgs-jax · {path.name}", verbose=False)
    scene = MapScene(server, splats, trajectory, keyframes)
    print(f"{path} is at http://{host}:{server.get_port()} (Ctrl-C ends)", flush=True)
    if block:
        try:
            threading.Event().wait()
        except KeyboardInterrupt:
            pass
        finally:
            scene.close()
    return scene
