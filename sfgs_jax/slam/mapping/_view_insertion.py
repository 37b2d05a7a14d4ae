"""Views that come into the map: kept, compared with it, and Gaussians set where it lacks their surface."""

from concurrent.futures import Future
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import Background
from sfgs_jax.geometry import Camera
from sfgs_jax.sensors import with_gain
from sfgs_jax.slam.config import MappingConfig, SeedingConfig
from sfgs_jax.slam.mapping._filling import filled
from sfgs_jax.slam.mapping._map_step import MapStep, prune, seen_by
from sfgs_jax.slam.mapping._paging import with_surface_of
from sfgs_jax.slam.mapping._seeding import seed
from sfgs_jax.slam.mapping._view_step import pose_of, step_on_view, timing_of, view_room
from sfgs_jax.slam.state._gaussian_map import empty_map, grow, keyframe_room, move
from sfgs_jax.slam.state._map_state import MapState, View

_ANY_DEPTH = 1e6
"""Depth beyond that of any surface, metres."""

_background = Background()


def insert_view(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, float]:
    """Keep a view, and set Gaussians where the map lacks its surface. The map grows where it is full.

    A rendering of the view, which is that of the first step on it, tells where surface is missing. Before the
    map or a rendering's room is full, the programs of a larger one are compiled in the background. An extra
    view is only kept.

    Args:
        mapping: the map, which knows of the view's keyframe.
        view: the view to keep.
        camera: of the views.
        config: settings.

    Returns:
        The map state, and the loss of the map before; NaN of an extra view.
    """
    if view.extra:
        return replace(mapping, views=(*mapping.views, _exposed_as_last(view, mapping))), float("nan")
    mapping, done = _with_view(mapping, view, camera, config)
    compile_ahead(mapping, camera, config, needed=int(done.needed), in_view=int(done.in_view))
    return mapping, float(done.loss)


def compile_ahead(
    mapping: MapState, camera: Camera, config: MappingConfig, *, needed: int, in_view: int
) -> list[Future[object]]:
    """Compile the programs of twice the room in the background, once there is a quarter left of it.

    Args:
        mapping: the map, with at least one view.
        camera: of the views.
        config: settings.
        needed: room for pairs that the newest view needs.
        in_view: Gaussians that its camera sees.

    Returns:
        Done when they are compiled: those of a larger map, of more room for pairs and for Gaussians in view,
        and of more keyframes. None of them where there is room enough, or where they have been asked for
        before.
    """
    valid = np.asarray(mapping.map.gaussians.valid)
    capacity, pairs, seen = len(valid), mapping.pair_capacity, mapping.view_capacity
    rooms = []
    # Beyond what the memory has room for, far places leave instead.
    most = min(config.max_capacity, config.gaussians_in_memory)
    if 2 * capacity <= most and valid.sum() > capacity * 3 // 4:
        rooms.append((2 * capacity, pairs, seen))
    if needed > pairs * 3 // 4:
        rooms.append((capacity, 2 * pairs, seen))
    if in_view > seen * 3 // 4:
        rooms.append((capacity, pairs, view_room(seen + 1)))
    begun = [
        _background.once((*room, camera.shape, config), _use_room, room, mapping, camera, config)
        for room in rooms
    ]
    poses, keyframes = mapping.keyframe_poses, keyframe_room(len(mapping.keyframe_poses))
    if len(poses) > keyframes * 3 // 4:
        more = np.repeat(poses[-1:], 2 * keyframes, axis=0)
        begun.append(_background.once((capacity, 2 * keyframes), move, mapping.map, more, more))
    return [future for future in begun if future is not None]


def _use_room(room: tuple[int, int, int], mapping: MapState, camera: Camera, config: MappingConfig) -> None:
    """Take the newest view into an empty map with this room for Gaussians, pairs, and Gaussians in view."""
    capacity, pairs, seen = room
    empty = empty_map(mapping.map.gaussians.valid.shape[0])
    if len(empty.updates) < capacity:
        empty = grow(empty)
    view, poses = mapping.views[-1], mapping.keyframe_poses
    mapping = replace(mapping, map=empty, views=(), submaps=(), pair_capacity=pairs, view_capacity=seen)
    mapping, _ = _with_view(mapping, view, camera, config)
    # Tracing takes seconds that the tracker waits for, so only what the run will use before its end.
    if config.steps_per_view or config.steps_per_frame:
        mapping, _ = step_on_view(mapping, -1, camera, config)
        mapping = replace(mapping, map=prune(mapping.map, config.prune_opacity))
    jax.block_until_ready(move(mapping.map, poses, poses))


def _with_view(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, MapStep]:
    mapping = with_surface_of(mapping, view, camera, config)
    mapping = replace(mapping, views=(*mapping.views, _exposed_as_last(view, mapping)))
    mapping, done = step_on_view(mapping, -1, camera, config, learn=config.steps_per_view > 0)
    view = replace(mapping.views[-1], gain=np.asarray(done.seed_gain))
    mapping = replace(mapping, views=(*mapping.views[:-1], view))
    rgb, depth = seen_by(view, camera, timing_of(mapping))
    rgb = with_gain(rgb, 1 / done.seed_gain)
    return _seeded(mapping, view, rgb, depth, done.missing, camera, config, config.seeding), done


def fill(mapping: MapState, number: int, done: MapStep, camera: Camera, config: MappingConfig) -> MapState:
    """Set Gaussians where a view of the refinement shows what no view had for the map while it grew.

    An extra view may show surface beside that of the ordinary ones. Depth that is missing, or beyond
    `max_depth`, is guessed from the map and from the depth around. Guessed Gaussians are as large as the
    cells of a bare wall. They are half transparent, so that map steps can tell which are wrong.

    Args:
        mapping: the map with all of its views.
        number: of the view.
        done: the first map step on it.
        camera: of the views.
        config: settings.
    """
    view, seeding = mapping.views[number], config.seeding
    rgb, depth = seen_by(view, camera, timing_of(mapping))
    rgb = with_gain(rgb, 1 / done.seed_gain)
    if view.extra:
        mapping = _seeded(mapping, view, rgb, depth, done.empty, camera, config, seeding)
    if not seeding.filled_opacity:
        return mapping
    measured = (depth > 0) & (depth < seeding.max_depth)
    missing = done.empty & jnp.asarray(view.valid) & ~measured
    guessed = replace(
        seeding, min_cell=seeding.max_cell, opacity=seeding.filled_opacity, max_depth=_ANY_DEPTH
    )
    return _seeded(mapping, view, rgb, filled(done.depth), missing, camera, config, guessed)


def _seeded(
    mapping: MapState,
    view: View,
    rgb: Float[Array, "h w 3"],
    depth: Float[Array, "h w"],
    missing: Bool[Array, "h w"],
    camera: Camera,
    config: MappingConfig,
    seeding: SeedingConfig,
) -> MapState:
    """The map with Gaussians for the missing pixels of a view; it grows where it is full."""
    T_world_cam, keyframe = pose_of(view, mapping), jnp.asarray(view.keyframe, jnp.int32)
    while True:
        seeded, dropped = seed(mapping.map, rgb, depth, missing, camera, T_world_cam, keyframe, seeding)
        if not int(dropped) or 2 * len(seeded.updates) > config.max_capacity:
            break
        mapping = replace(mapping, map=grow(mapping.map))
    return replace(mapping, map=seeded, dropped_seeds=mapping.dropped_seeds + int(dropped))


def _exposed_as_last(view: View, mapping: MapState) -> View:
    """The view with the newest one's gain: a camera's exposure changes slowly."""
    return replace(view, gain=mapping.views[-1].gain) if mapping.views else view
