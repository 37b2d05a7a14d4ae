"""Scans of a street by a spinning LiDAR with rings, ray-cast in float64."""

import numpy as np


def street_scan(
    T_world_sensor: np.ndarray, rng: np.random.Generator, *, rings: int = 64, steps: int = 1300
) -> np.ndarray:
    """Points (N, 3), float64 in sensor coordinates, of a street of houses, poles, cars and spheres.

    Rings from -24 to 12 degrees, 2 cm of noise along the rays, returns up to 60 m. The scene stays the same;
    z points up, and the sensor of the identity stands 1.8 m above the ground.
    """
    azimuth = np.linspace(-np.pi, np.pi, steps, endpoint=False) + rng.uniform(0, 2 * np.pi / steps)
    elevation = np.radians(np.linspace(-24, 12, rings))
    a, e = np.meshgrid(azimuth, elevation)
    rays = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], -1).reshape(-1, 3)
    world = rays @ T_world_sensor[:3, :3].T
    origin = T_world_sensor[:3, 3]
    ranges = np.full(len(rays), np.inf)
    for low, high in _boxes():
        ranges = np.minimum(ranges, _box(origin, world, low, high))
    for centre, radius in _SPHERES:
        ranges = np.minimum(ranges, _sphere(origin, world, np.asarray(centre), radius))
    ranges = np.where(ranges < 60, ranges + rng.normal(scale=0.02, size=ranges.shape), np.inf)
    seen = np.isfinite(ranges) & (ranges > 1)
    return rays[seen] * ranges[seen, None]


_SPHERES = [((9.0, 4.0, 0.5), 1.6), ((-7.0, -4.5, 0.4), 1.3), ((20.0, -5.0, 0.8), 2.0)]


def _boxes() -> list[tuple[np.ndarray, np.ndarray]]:
    ground, half = -1.8, 1000.0
    boxes = [((-half, -half, ground - 1), (half, half, ground))]
    layout = np.random.default_rng(7)
    for side in (-1, 1):
        x = -55.0
        while x < 55:  # houses with gaps and recesses
            width, depth, height = layout.uniform(6, 14), layout.uniform(8, 11), layout.uniform(4, 12)
            near, far = sorted((side * depth, side * (depth + 10)))
            boxes.append(((x, near, ground), (x + width, far, height)))
            x += width + layout.uniform(0.5, 4)
        for x in np.arange(-50, 50, 12.0):  # poles and cars at the kerb
            boxes.append(((x, side * 6.0, ground), (x + 0.3, side * 6.0 + 0.3, 4.0)))
            start = x + layout.uniform(2, 6)
            near, far = sorted((side * 4.0, side * 5.8))
            boxes.append(((start, near, ground), (start + 4.2, far, ground + 1.5)))
    return [(np.asarray(low, float), np.asarray(high, float)) for low, high in boxes]


def _box(origin: np.ndarray, rays: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / rays, (high - origin) / rays
    enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
    return np.where((enter < leave) & (enter > 0), enter, np.inf)


def _sphere(origin: np.ndarray, rays: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    offset = origin - centre
    b = rays @ offset
    root = b**2 - (offset @ offset - radius**2)
    return np.where((root > 0) & (b < 0), -b - np.sqrt(np.maximum(root, 0)), np.inf)
