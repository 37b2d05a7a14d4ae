"""Ways to look at a map: its colours, and false colours that show something else."""

from dataclasses import dataclass
from typing import Literal, get_args

import cv2
import numpy as np
from jaxtyping import Float, Float32, Int, UInt8

from sfgs_jax.geometry import Camera
from sfgs_jax.viewer._cropping import Box
from sfgs_jax.viewer._levelling import normals_of
from sfgs_jax.viewer._splats import Splats

Mode = Literal["splats", "points", "depth", "normals", "uncertainty"]
"""What a map is drawn as."""

MODES: tuple[Mode, ...] = get_args(Mode)

_NEAREST = 0.05
"""Metres in front of a camera, from which on it sees."""


_TURBO = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO).reshape(256, 3)[:, ::-1]


@dataclass(frozen=True)
class Look:
    """How a map is drawn.

    Attributes:
        mode: what is drawn.
        size: factor on the standard deviations; of points, on their size.
        least_opacity: Gaussians below this opacity are hidden.
        crop: what is outside is hidden; None hides nothing.
    """

    mode: Mode = "splats"
    size: float = 1.0
    least_opacity: float = 0.0
    crop: Box | None = None

    def shown(self, centres: Float[np.ndarray, "n 3"], opacities: Float[np.ndarray, " n"]) -> np.ndarray:
        """Which Gaussians are drawn."""
        shown = opacities >= self.least_opacity
        return shown if self.crop is None else shown & self.crop.contains(centres)


def turbo(level: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n 3"]:
    """Turbo colours: 0 is red, 1 is blue; values outside are clipped."""
    return _TURBO[((1 - np.clip(level, 0, 1)) * 255).round().astype(np.uint8)]


def normal_colours(splats: Splats, axes: Float[np.ndarray, "3 3"]) -> Float32[np.ndarray, "n 3"]:
    """Sizes of the normals along three axes as red, green and blue; a normal's sign has no meaning.

    Args:
        splats: the map.
        axes: rows: right, forward and up.
    """
    return np.abs(normals_of(splats) @ axes.T.astype(np.float32))


def depths_from(
    centres: Float[np.ndarray, "n 3"], T_world_cam: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, " n"]:
    """Depths along a camera's view, metres."""
    return (centres - T_world_cam[:3, 3].astype(np.float32)) @ T_world_cam[:3, 2].astype(np.float32)


def depth_range(depths: Float[np.ndarray, "*n"]) -> tuple[float, float]:
    """Depths of the first and the last colour, metres: 5 and 95 % of what lies in front is nearer."""
    front = depths[depths > _NEAREST]
    if not front.size:
        return 0.0, 1.0
    near, far = np.percentile(front, [5, 95])
    return float(near), float(max(far, near + _NEAREST))


def count_views(
    centres: Float[np.ndarray, "n 3"], poses: Float[np.ndarray, "m 4 4"], camera: Camera
) -> Int[np.ndarray, " n"]:
    """Number of cameras that have a point in their image; walls in front of it are not considered.

    Args:
        centres: points, world coordinates, metres.
        poses: `T_world_cam` of the cameras.
        camera: their intrinsics.
    """
    count = np.zeros(len(centres), np.int32)
    fx, fy, cx, cy = (float(value) for value in (camera.fx, camera.fy, camera.cx, camera.cy))
    for pose in poses.astype(np.float32):
        x, y, z = ((centres - pose[:3, 3]) @ pose[:3, :3]).T
        front = np.maximum(z, _NEAREST)
        u, v = fx * x / front + cx, fy * y / front + cy
        inside = (u > -0.5) & (u < camera.width - 0.5) & (v > -0.5) & (v < camera.height - 0.5)
        count += inside & (z > _NEAREST)
    return count
