"""Depth images of scenes with known geometry, ray-cast in float64."""

import numpy as np

from sfgs_jax import Camera
from sfgs_jax.geometry import se3

CORNER = [([0, 0, -1.0], -3.0), ([-1.0, 0, 0], -1.2), ([0, -1.0, 0], -0.9)]  # n . X = d: a room's corner
SPHERES = [([-0.5, 0.1, 2.2], 0.5), ([0.5, -0.4, 1.8], 0.3)]
WALL = [([0.1, -0.2, -1.0], -2.0)]


def cast(camera: Camera, T_world_cam=None, planes=CORNER, spheres=SPHERES) -> np.ndarray:
    """Depth image (H, W), float32 metres, of planes (normal, distance) and spheres (centre, radius)."""
    T_world_cam = np.eye(4) if T_world_cam is None else np.asarray(T_world_cam, np.float64)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], -1)
    rays = rays @ T_world_cam[:3, :3].T
    origin = T_world_cam[:3, 3]
    hits = []
    for normal, distance in planes:
        hits.append((distance - origin @ normal) / (rays @ np.asarray(normal)))
    for centre, radius in spheres:
        offset = origin - centre
        a, b, c = (rays**2).sum(-1), rays @ offset, offset @ offset - radius**2
        root = b**2 - a * c
        hits.append(np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf))
    depth = np.min([np.where(h > 0, h, np.inf) for h in hits], axis=0)
    return np.where(np.isfinite(depth), depth, 0).astype(np.float32)


def motion_error(found: np.ndarray, known: np.ndarray) -> tuple[float, float]:
    """Translation in metres and rotation in degrees between two 4 x 4 motions."""
    difference = np.linalg.inv(known) @ found
    # The arc cosine of the trace would turn rounding into hundredths of a degree.
    angle = np.linalg.norm(se3.logs_of(difference[None])[0, 3:])
    return float(np.linalg.norm(difference[:3, 3])), float(np.degrees(angle))
