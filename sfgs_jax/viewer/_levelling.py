"""Up, and the height of the floor, from the planes of a map."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from sfgs_jax.viewer._splats import Splats

_SAMPLE = 6000
"""Gaussians that take part."""

_FEWEST = 100
"""Flat Gaussians, below which planes could be chance."""

_FLAT = 0.5
"""Largest ratio of a flat Gaussian's smallest standard deviation to the next."""

_SEARCHED = np.radians(60)
"""Largest angle from the cameras' mean up."""

_DIRECTIONS = 1500
"""Directions of the sphere that are tried."""

_WIDTH = np.radians(10)
"""Standard deviation of the normals of a plane: those of Gaussians are rough."""

_LEVEL, _UPRIGHT, _OTHER = 0.35, 0.45, 0.2
"""Shares of level, upright and other surface in the search."""

_GATES = np.radians([20, 20, 15, 15, 10, 10, 10, 10])
"""Largest angle between a normal and a level or an upright surface, by step."""

_SHARE_GATE = np.radians(20)
"""The same for the share of the surface that is level or upright."""

_LEAST_SHARE = 0.55
"""Below this share a map has no dominant planes; normals in all directions have 0.4."""

_LEAST_GAP = 0.03
"""Least gap of the two smallest eigenvalues, shares of the surface: one wall alone does not tell up."""

_PRIOR = 0.2
"""Log-likelihood that a direction gains with the cosine of its angle to the cameras' mean up."""


@dataclass(frozen=True)
class Level:
    """A map's vertical.

    Attributes:
        up: unit vector.
        floor: height of the floor along `up`, metres.
        share: of the surface that is level or upright within twenty degrees, in [0, 1].
    """

    up: Float[np.ndarray, "3"]
    floor: float
    share: float


def normals_of(splats: Splats) -> Float[np.ndarray, "n 3"]:
    """Unit normals, the directions of the smallest standard deviations; their signs have no meaning."""
    return np.linalg.eigh(splats.covariances)[1][..., 0]


def find_level(splats: Splats, poses: Float[np.ndarray, "m 4 4"]) -> Level | None:
    """Up by the planes of a map, which are level or upright where people live.

    A search over directions near the cameras' mean up finds the one that is likeliest along or across the
    normals. Gated least squares then sharpen it. Each step has a closed form, the smallest eigenvector
    of Σ w n nᵀ over upright surfaces minus Σ w n nᵀ over level ones.

    Args:
        splats: the map.
        poses: `T_world_cam` of its cameras; without any, a camera at the origin as recordings begin with.

    Returns:
        The vertical; None where the map has no dominant planes, or they do not tell it.
    """
    normals, weights, centres = _flat_surface(splats)
    if len(normals) < _FEWEST:
        return None
    prior = _mean_up(poses)
    up = _search(normals, weights, prior)
    gap = 0.0
    for gate in _GATES:
        level, upright = _gated(normals, up, gate)
        scatter = _scatter(normals, weights * upright) - _scatter(normals, weights * level)
        values, vectors = np.linalg.eigh(scatter)
        up, gap = vectors[:, 0], float(values[1] - values[0])
        up = up if up @ prior > 0 else -up
    share = float(weights @ np.logical_or(*_gated(normals, up, _SHARE_GATE)))
    level, _ = _gated(normals, up, _GATES[-1])
    if share < _LEAST_SHARE or gap < _LEAST_GAP:
        return None
    heights = centres[level] @ up if level.any() else centres @ up
    return Level(up, float(np.percentile(heights, 2)), share)


def level_axes(up: Float[np.ndarray, "3"], poses: Float[np.ndarray, "m 4 4"]) -> Float[np.ndarray, "3 3"]:
    """Rows: right, forward and up, of which the first two are level; forward is the first camera's.

    Args:
        up: unit vector.
        poses: `T_world_cam` of the cameras; without any, z is forward.
    """
    forward = poses[0, :3, 2] if len(poses) else np.array([0.0, 0.0, 1.0])
    if abs(forward @ up) > 0.95:
        forward = -poses[0, :3, 1] if len(poses) else np.array([0.0, -1.0, 0.0])
    forward = forward - (forward @ up) * up
    forward = forward / np.linalg.norm(forward)
    return np.stack([np.cross(forward, up), forward, up])


def _flat_surface(
    splats: Splats,
) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, " k"], Float[np.ndarray, "k 3"]]:
    """Normals, weights that sum to 1 and centres of a sample of flat Gaussians."""
    count = len(splats.centres)
    chosen = np.random.default_rng(0).permutation(count)[: 2 * _SAMPLE]
    variances, axes = np.linalg.eigh(splats.covariances[chosen].astype(np.float64))
    sigmas = np.sqrt(np.maximum(variances, 1e-12))
    # Few large Gaussians of an empty wall would otherwise outweigh the rest.
    areas = sigmas[:, 1] * sigmas[:, 2]
    areas = np.minimum(areas, np.percentile(areas, 90)) if len(areas) else areas
    flat = np.flatnonzero(sigmas[:, 0] < _FLAT * sigmas[:, 1])[:_SAMPLE]
    weights = areas[flat] * splats.opacities[chosen[flat], 0]
    return axes[flat, :, 0], weights / max(weights.sum(), 1e-12), splats.centres[chosen[flat]]


def _mean_up(poses: Float[np.ndarray, "m 4 4"]) -> Float[np.ndarray, "3"]:
    mean = -poses[:, :3, 1].mean(axis=0) if len(poses) else np.array([0.0, -1.0, 0.0])
    length = np.linalg.norm(mean)
    return mean / length if length > 0.1 else np.array([0.0, -1.0, 0.0])


def _search(
    normals: Float[np.ndarray, "k 3"], weights: Float[np.ndarray, " k"], prior: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """The likeliest of directions spread over the sphere by the golden angle.

    The density of a normal is a mixture over its angle to the plane across `up`: level, upright, or any
    direction. A cap is smaller than a band, so level surface tells more.
    """
    place = np.arange(_DIRECTIONS)
    z = 1 - (2 * place + 1) / _DIRECTIONS
    angle = place * np.pi * (3 - np.sqrt(5))
    directions = np.stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z], axis=1)
    directions = np.concatenate([prior[None], directions[directions @ prior > np.cos(_SEARCHED)]])
    from_plane = np.arcsin(np.minimum(np.abs(directions @ normals.T), 1))
    near_level = np.exp(-0.5 * ((np.pi / 2 - from_plane) / _WIDTH) ** 2) / _WIDTH**2
    near_upright = np.exp(-0.5 * (from_plane / _WIDTH) ** 2) / (np.sqrt(np.pi / 2) * _WIDTH)
    scores = np.log(_LEVEL * near_level + _UPRIGHT * near_upright + _OTHER) @ weights
    return directions[np.argmax(scores + _PRIOR * directions @ prior)]


def _gated(
    normals: Float[np.ndarray, "k 3"], up: Float[np.ndarray, "3"], gate: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which surfaces are level, and which are upright."""
    cosines = np.abs(normals @ up)
    return cosines > np.cos(gate), cosines < np.sin(gate)


def _scatter(normals: Float[np.ndarray, "k 3"], weights: Float[np.ndarray, " k"]) -> Float[np.ndarray, "3 3"]:
    return (weights[:, None] * normals).T @ normals
