"""Paging: submaps of far places leave a map that is full, and come back with a view of their surface.

The idea is RTAB-Map's working memory (Labbé and Michaud, 2013). Here the place of the surface tells what is
needed, so that a closed loop brings back what it leads to.
"""

from dataclasses import replace

import jax
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._submaps import Submap, submap_of, with_submaps, without

_MARGIN = 0.5
"""Distance from a view's surface within which a submap is part of it, metres."""
_FULL, _KEPT = 7 / 8, 5 / 8
"""Shares of the memory in use with which Gaussians leave, and to which they do. Room is left for new ones."""
_SAMPLES = 16
"""Pixels of a view's longer side that are looked up."""


def with_surface_of(mapping: MapState, view: View, camera: Camera, config: MappingConfig) -> MapState:
    """The map with all Gaussians of the surface that a view shows, without far ones if it is full.

    Args:
        mapping: before, which knows of the view's keyframe.
        view: to be rendered next.
        camera: of the views.
        config: settings.
    """
    T = _T_world_cam(mapping, view)
    shown = _shown(mapping, view, T, camera)
    if shown.any():
        submaps = tuple(s for s, here in zip(mapping.submaps, shown, strict=True) if here)
        left = tuple(s for s, here in zip(mapping.submaps, shown, strict=True) if not here)
        # Far ones leave first, so that the map need not grow.
        mapping = _without_far(mapping, T[:3, 3], config, sum(len(submap) for submap in submaps), left)
        return replace(mapping, map=with_submaps(mapping.map, submaps, mapping.keyframe_poses))
    return _without_far(mapping, T[:3, 3], config, 0, mapping.submaps)


def is_whole(mapping: MapState, view: View, camera: Camera) -> bool:
    """Whether the map has all Gaussians of the surface that a view shows.

    Args:
        mapping: the map.
        view: one of its views.
        camera: of the views.
    """
    return not _shown(mapping, view, _T_world_cam(mapping, view), camera).any()


def _T_world_cam(mapping: MapState, view: View) -> Float[np.ndarray, "4 4"]:
    own = np.asarray(view.T_keyframe_cam.wxyz_xyz)
    keyframe, motion = se3.matrices_of(np.stack([mapping.keyframe_poses[view.keyframe], own]))
    return keyframe @ motion


def _shown(
    mapping: MapState, view: View, T: Float[np.ndarray, "4 4"], camera: Camera
) -> Bool[np.ndarray, " s"]:
    """Submaps whose box holds a point of the view's surface."""
    if not mapping.submaps:
        return np.zeros(0, bool)
    every = max(1, max(view.depth.shape) // _SAMPLES)
    depth = np.asarray(view.depth)[::every, ::every]
    v, u = np.nonzero(depth > 0)
    z = depth[v, u]
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    rays = np.stack([(every * u - cx) / fx, (every * v - cy) / fy, np.ones(len(u))], axis=1)
    points = (rays * z[:, None]) @ T[:3, :3].T + T[:3, 3]
    return _distances(mapping, mapping.submaps, points).min(axis=1, initial=np.inf) < _MARGIN


def _distances(
    mapping: MapState, submaps: tuple[Submap, ...], points: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "s p"]:
    """Distances of points in the world from the boxes of submaps, metres."""
    poses = mapping.keyframe_poses[[submap.keyframe for submap in submaps]]
    T = np.linalg.inv(se3.matrices_of(poses))
    boxes = np.stack([submap.box for submap in submaps])
    local = points @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    outside = np.maximum(np.maximum(boxes[:, None, 0] - local, local - boxes[:, None, 1]), 0)
    return np.linalg.norm(outside, axis=-1)


def _without_far(
    mapping: MapState,
    position: Float[np.ndarray, "3"],
    config: MappingConfig,
    coming: int,
    submaps: tuple[Submap, ...],
) -> MapState:
    """The map without its farthest places if it would be full, and these as submaps beside those given."""
    mapping = replace(mapping, submaps=submaps)
    count = int(np.asarray(mapping.map.gaussians.valid).sum()) + coming
    if count <= _FULL * config.gaussians_in_memory:
        return mapping
    host = jax.tree.map(np.asarray, mapping.map)
    valid, places = host.gaussians.valid, host.keyframes // config.paging.place_keyframes
    away = np.full(places.max(initial=0) + 1, np.inf, np.float32)
    distances = np.linalg.norm(host.gaussians.means[valid] - position.astype(np.float32), axis=1)
    np.minimum.at(away, places[valid], distances)
    leaving, gone = [], np.zeros_like(valid)
    for place in np.argsort(-np.where(np.isfinite(away), away, -1), kind="stable"):
        if not config.paging.reach <= away[place] < np.inf or count <= _KEPT * config.gaussians_in_memory:
            break
        there = valid & (places == place)
        number = mapping.num_submaps + len(leaving)
        leaving.append(submap_of(host, there, mapping.keyframe_poses, number))
        gone |= there
        count -= len(leaving[-1])
    if not leaving:
        return mapping
    return replace(
        mapping,
        map=without(mapping.map, gone),
        submaps=(*submaps, *leaving),
        num_submaps=mapping.num_submaps + len(leaving),
    )
