"""A mesh or a point cloud in the browser."""

from pathlib import Path

import numpy as np
import trimesh
import viser
from jaxtyping import Float

from sfgs_jax.arrays import InputError
from sfgs_jax.splatting import contents_of, load_coloured_points
from sfgs_jax.splatting.mesh import Mesh, load_mesh
from sfgs_jax.viewer._server import Page, announce, start_server, wait_for_interrupt

_UP, _AHEAD = np.array([0.0, -1.0, 0.0]), np.array([0.0, 0.0, 1.0])
"""Of the axes of a map: y down, z forward."""

_POINT_SHARE = 0.002
"""Diameter of a point as a share of the cloud's size."""


class ModelScene(Page):
    """A mesh or a point cloud in a viser server's scene, in the axes of a map.

    Args:
        server: the viser server; `close` stops it.
        model: the mesh, or places and RGB of points.

    Attributes:
        server: the viser server.
        node: the model's node, `/model`.
    """

    def __init__(
        self, server: viser.ViserServer, model: Mesh | tuple[Float[np.ndarray, "n 3"], np.ndarray]
    ) -> None:
        super().__init__(server)
        if isinstance(model, Mesh):
            corners, count = model.vertices, f"{len(model.triangles):,} triangles"
            levels = np.round(255 * np.clip(model.rgb, 0, 1)).astype(np.uint8)
            shape = trimesh.Trimesh(corners, model.triangles, vertex_colors=levels, process=False)
            self.node: viser.SceneNodeHandle = server.scene.add_mesh_trimesh("/model", shape)
        else:
            corners, rgb = model
            count = f"{len(corners):,} points"
            size = _POINT_SHARE * float(np.linalg.norm(np.ptp(corners, axis=0)))
            self.node = server.scene.add_point_cloud(
                "/model", corners.astype(np.float32), rgb, point_size=max(size, 1e-4), point_shape="circle"
            )
        server.gui.add_markdown(count)
        server.scene.set_up_direction(_UP)
        low, middle, high = np.percentile(corners, [5, 50, 95], axis=0)
        start = server.initial_camera
        start.position = middle - 1.2 * np.linalg.norm(high - low) * (_AHEAD - 0.4 * _UP)
        start.look_at, start.up = middle, _UP

    def close(self) -> None:
        """Stop the server."""
        self.server.stop()


def view_model(
    path: Path | str,
    *,
    port: int = 8080,
    host: str = "127.0.0.1",
    open_browser: bool = False,
    block: bool = True,
) -> ModelScene:
    """Show a mesh or a point cloud in the browser, such as `sfgs-jax export` writes them.

    Prints the address of the page. In a notebook the result of `block=False` shows the page in its cell.

    Args:
        path: a .ply file of points, or a .ply or .glb file of a mesh.
        port: port to listen on; the next free one is taken if it is in use, and 0 takes any free one.
        host: address to listen on; "0.0.0.0" lets other machines look, without any password.
        open_browser: open the page in the browser of this machine.
        block: wait for Ctrl-C, stop the server, and return then.

    Returns:
        The scene; without `block` it is live until its `close`.

    Raises:
        InputError: there is no such file, it holds Gaussians, or it is damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"There is no file {path}.")
    contents = contents_of(path)
    if contents == "splats":
        raise InputError(f"{path} holds Gaussians, or is of an unknown format; use view_run.")
    model = load_mesh(path) if contents == "mesh" else load_coloured_points(path)
    scene = ModelScene(start_server(host, port, f"sfgs-jax · {path.name}"), model)
    announce(path, scene.url, host, open_browser=open_browser)
    if block:
        wait_for_interrupt(scene.close)
    return scene
