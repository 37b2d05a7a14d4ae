"""Places for a browser's camera."""

import numpy as np
import viser
from jaxtyping import Float

from sfgs_jax.geometry import Camera, quaternions_from_rotations

_BEHIND_M, _ABOVE_M, _AHEAD_M = 1.0, 0.4, 1.5


def vertical_field_of_view(camera: Camera) -> float:
    """Angle between the upper and the lower edge of the image, radians."""
    return float(2 * np.arctan(camera.height / (2 * float(camera.fy))))


def place_behind(
    T_world_cam: Float[np.ndarray, "4 4"],
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """A place behind and above a camera, and one ahead of it to look at.

    Args:
        T_world_cam: pose of the camera.
    """
    position, down, forward = T_world_cam[:3, 3], T_world_cam[:3, 1], T_world_cam[:3, 2]
    return position - _BEHIND_M * forward - _ABOVE_M * down, position + _AHEAD_M * forward


def look_from_behind(client: viser.ClientHandle, T_world_cam: Float[np.ndarray, "4 4"]) -> None:
    """Take a browser behind a camera.

    Args:
        client: the browser.
        T_world_cam: pose of the camera.
    """
    position, target = place_behind(T_world_cam)
    with client.atomic():
        client.camera.position = position
        client.camera.look_at = target


def look_through(client: viser.ClientHandle, T_world_cam: Float[np.ndarray, "4 4"], camera: Camera) -> None:
    """Let a browser see what a camera sees.

    Args:
        client: the browser.
        T_world_cam: pose of the camera.
        camera: its intrinsics; the height of the page shows the height of its image.
    """
    with client.atomic():
        client.camera.fov = vertical_field_of_view(camera)
        client.camera.wxyz = quaternions_from_rotations(T_world_cam[None, :3, :3])[0]
        client.camera.position = T_world_cam[:3, 3]
