"""A finished run, or a splat file, in the browser."""

import threading
from pathlib import Path

import numpy as np
import viser

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Trajectory, read_tum
from sfgs_jax.splatting import load_ply
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
    folder = path.parent if path.is_file() else path
    if not path.exists():
        raise InputError(f"There is no {path}: give the folder that a run wrote, or a .ply file.")
    ply = path if path.is_file() else folder / "map.ply"
    if not ply.is_file():
        raise InputError(f"{folder} holds no map.ply: give the folder that a run wrote, or a .ply file.")
    splats = splats_of(load_ply(ply))
    nothing = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
    trajectory, keyframes = (
        read_tum(folder / name) if path.is_dir() and (folder / name).is_file() else nothing
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
