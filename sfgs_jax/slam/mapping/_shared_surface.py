"""Surface that two maps have in common, and how much brighter one of them has it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._view_step import step_on_view
from sfgs_jax.slam.state._map_state import MapState, View

_NEAREST = 0.05
"""Depth from which on a point has an image, metres."""


class SharedSurface(NamedTuple):
    """Comparison of points with a map.

    Attributes:
        mapping: the map, with room for the pairs of the views that were compared.
        shared: (n,) points on surface that the map has.
        brighter: (3,) factor on each channel of colours that go with the views' gains, to those of the map.
    """

    mapping: MapState
    shared: Bool[np.ndarray, " n"]
    brighter: Float[np.ndarray, "3"]


def shared_surface(
    mapping: MapState,
    places: range,
    points: Float[np.ndarray, "n 3"],
    camera: Camera,
    config: MappingConfig,
) -> SharedSurface:
    """Points on surface that a map has: most of the views that show them say so.

    Args:
        mapping: the map with its views.
        places: of the views to ask.
        points: in the world, metres.
        camera: of the views.
        config: settings.
    """
    shown, had = np.zeros(len(points), int), np.zeros(len(points), int)
    brighter, pixels = np.zeros(3), 0
    for place in places:
        mapping, done = step_on_view(mapping, place, camera, config, learn=False)
        view, missing = mapping.views[place], np.asarray(done.missing)
        on, at = _seen(mapping, view, points, camera, config.seeding.depth_margin)
        shown[on] += 1
        had[on] += ~missing[at[:, 1], at[:, 0]]
        count = int((~missing & (np.asarray(view.depth) > 0)).sum())
        brighter += count * (np.log(np.asarray(view.gain)) - np.log(np.asarray(done.gain)))
        pixels += count
    return SharedSurface(mapping, 2 * had > shown, np.exp(brighter / max(pixels, 1)))


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
