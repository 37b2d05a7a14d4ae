"""Two maps as one: the views of both, and the Gaussians of both where the first map lacks surface."""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.arrays import doubled
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_update import step_on_view
from sfgs_jax.slam.state._gaussian_map import GaussianMap, empty_map, move
from sfgs_jax.slam.state._map_state import MapState, View

_NEAREST = 0.05
"""Depth from which on a point has an image, metres."""


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
        dropped_seeds=mapping.dropped_seeds + other.dropped_seeds,
    )


def with_lacking_gaussians(
    mapping: MapState, other: MapState, camera: Camera, config: MappingConfig
) -> MapState:
    """The map with those Gaussians of another one whose surface it lacks.

    A Gaussian lies on surface that the map has, if most of the views that show it say so. Only the other
    map's own views are asked. It may become larger than `max_capacity`; then it grows no further.

    Args:
        mapping: with the views of both, and with all keyframes where they are now.
        other: the other map, as it was when its views were joined.
        camera: of the views.
        config: settings.
    """
    count, number = len(other.keyframe_poses), len(other.views)
    first = len(mapping.keyframe_poses) - count
    moved = move(other.map, other.keyframe_poses, mapping.keyframe_poses[first:])
    means = np.asarray(moved.gaussians.means)
    shown, had = np.zeros(len(means), int), np.zeros(len(means), int)
    for place in range(len(mapping.views) - number, len(mapping.views)):
        mapping, done = step_on_view(mapping, place, camera, config, learn=False)
        on, pixels = _seen(mapping, mapping.views[place], means, camera, config.seeding.depth_margin)
        shown[on] += 1
        had[on] += ~np.asarray(done.missing)[pixels[:, 1], pixels[:, 0]]
    lacking = np.asarray(moved.gaussians.valid) & (2 * had <= shown)
    return replace(mapping, map=_together(mapping.map, moved, lacking, first, config.capacity))


def _seen(
    mapping: MapState, view: View, points: Float[np.ndarray, "n 3"], camera: Camera, margin: float
) -> tuple[Int[np.ndarray, " k"], Int[np.ndarray, "k 2"]]:
    """Which points lie on the surface that a view measures, and their pixels (u, v)."""
    tangent = np.asarray(view.correction, np.float64)[None]
    T_keyframe_cam = np.asarray(view.T_keyframe_cam.wxyz_xyz)
    keyframe, own = se3.matrices_of(np.stack([mapping.keyframe_poses[view.keyframe], T_keyframe_cam]))
    T = keyframe @ own @ se3.exps_of(tangent)[0]
    x, y, z = ((points - T[:3, 3]) @ T[:3, :3]).T
    far = np.maximum(z, _NEAREST)
    u = np.rint(float(camera.fx) * x / far + float(camera.cx))
    v = np.rint(float(camera.fy) * y / far + float(camera.cy))
    inside = np.flatnonzero((z > _NEAREST) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height))
    pixels = np.stack([u[inside], v[inside]], axis=-1).astype(int)
    depth = np.asarray(view.depth)[pixels[:, 1], pixels[:, 0]]
    on = (depth > 0) & (np.abs(z[inside] - depth) < margin * depth)
    return inside[on], pixels[on]


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
