"""The browsers' cameras."""

from collections.abc import Callable

import numpy as np
import viser
from jaxtyping import Float

from sfgs_jax.geometry import quaternions_from_rotations, rotations_from_quaternions

_NUDGE = 1e-3
"""viser sends a camera only if it differs from the one that it knows, metres."""


class BrowserCameras:
    """Reads and moves the cameras of the browsers that look.

    Args:
        server: the viser server.
        on_move: told that a browser's camera has moved.
    """

    def __init__(self, server: viser.ViserServer, on_move: Callable[[], None]) -> None:
        self._server, self._on_move = server, on_move
        self._own_fov: dict[int, float] = {}
        server.on_client_connect(self._connected)

    @property
    def positions(self) -> Float[np.ndarray, "b 3"]:
        """Of all browsers' cameras."""
        found = [client.camera.position for client in self._server.get_clients().values()]
        return np.asarray(found, np.float64).reshape(-1, 3)

    def look_from(
        self, T_world_cam: Float[np.ndarray, "4 4"], fov: float, client: viser.ClientHandle | None = None
    ) -> None:
        """Take browsers to a pose.

        Args:
            T_world_cam: the pose.
            fov: vertical field of view, radians.
            client: the browser; None takes all of them.
        """
        clients = self._server.get_clients().values() if client is None else [client]
        for each in clients:
            self._own_fov.setdefault(each.client_id, each.camera.fov)
            with each.atomic():
                each.camera.position = T_world_cam[:3, 3]
                each.camera.wxyz = quaternions_from_rotations(T_world_cam[None, :3, :3])[0]
                each.camera.fov = fov

    def let_go(self, up: Float[np.ndarray, "3"]) -> None:
        """Give browsers their own field of view again, and turn them upright."""
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.fov = self._own_fov.pop(client.client_id, client.camera.fov)
                client.camera.up_direction = up

    def turn_up(self, up: Float[np.ndarray, "3"]) -> None:
        """Turn browsers upright where they stand, after the scene's up has changed."""
        for client in self._server.get_clients().values():
            with client.atomic():
                position, look_at = client.camera.position.copy(), client.camera.look_at.copy()
                client.camera.up_direction = up
                client.camera.position = position + _NUDGE
                client.camera.look_at = look_at

    def _connected(self, client: viser.ClientHandle) -> None:
        client.camera.on_update(lambda _: self._on_move())
        self._on_move()


def pose_of(camera: viser.CameraHandle) -> Float[np.ndarray, "4 4"]:
    """`T_world_cam` of a browser's camera."""
    pose = np.eye(4)
    pose[:3, :3] = rotations_from_quaternions(np.asarray(camera.wxyz)[None])[0]
    pose[:3, 3] = camera.position
    return pose
