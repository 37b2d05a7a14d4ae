"""Two maps as one: the views of both, and the Gaussians of the second where the first lacks surface."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool

from sfgs_jax.arrays import doubled
from sfgs_jax.geometry import Camera
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_exposure import brightened, in_the_exposure_of
from sfgs_jax.slam.mapping._shared_surface import shared_surface
from sfgs_jax.slam.state._gaussian_map import GaussianMap, empty_map, move
from sfgs_jax.slam.state._map_state import MapState


def joined_views(mapping: MapState, other: MapState, shift: int) -> MapState:
    """The map with the views of another one, as one of its recordings; their Gaussians are left out.

    Args:
        mapping: before.
        other: the other map, whose keyframes come after those of the first.
        shift: added to the numbers of its frames.
    """
    first = len(mapping.keyframe_poses)
    views = (replace(v, keyframe=v.keyframe + first, frame=v.frame + shift) for v in other.views)
    return replace(
        mapping,
        views=(*mapping.views, *views),
        keyframe_poses=np.concatenate([mapping.keyframe_poses, other.keyframe_poses]),
        num_steps=mapping.num_steps + other.num_steps,
        pair_capacity=max(mapping.pair_capacity, other.pair_capacity),
        view_capacity=max(mapping.view_capacity, other.view_capacity),
        dropped_seeds=mapping.dropped_seeds + other.dropped_seeds,
    )


def with_lacking_gaussians(
    mapping: MapState, other: MapState, camera: Camera, config: MappingConfig
) -> MapState:
    """The map with those Gaussians of another one whose surface it lacks, in its exposure.

    The other map's own views are asked. The result may be larger than `max_capacity`; it grows no further.

    Args:
        mapping: with the views of both, and with all keyframes where they are now.
        other: the other map, as it was when its views were joined.
        camera: of the views.
        config: settings.
    """
    first = len(mapping.keyframe_poses) - len(other.keyframe_poses)
    places = range(len(mapping.views) - len(other.views), len(mapping.views))
    moved = move(other.map, other.keyframe_poses, mapping.keyframe_poses[first:])
    means = np.asarray(moved.gaussians.means)
    mapping, shared, brighter = shared_surface(mapping, places, means, camera, config)
    lacking = np.asarray(moved.gaussians.valid) & ~shared
    together = _together(mapping.map, brightened(moved, brighter), lacking, first, config.capacity)
    return in_the_exposure_of(replace(mapping, map=together), places, brighter)


def _together(
    mine: GaussianMap, other: GaussianMap, chosen: Bool[np.ndarray, " m"], first: int, capacity: int
) -> GaussianMap:
    """The Gaussians of a map and the chosen ones of another, without gaps, on the host."""
    mine, other = (jax.tree.map(np.asarray, gaussian_map) for gaussian_map in (mine, other))
    kept = np.asarray(mine.gaussians.valid)
    old, new = int(kept.sum()), int(chosen.sum())
    room = jax.tree.map(np.array, empty_map(doubled(capacity, old + new)))

    def put(free: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        free[:old], free[old : old + new] = a[kept], b[chosen]
        return free

    together = jax.tree.map(put, room, mine, other)
    together.keyframes[old : old + new] += first
    return jax.device_put(together)
