"""Updates of the map on the host: it follows the keyframes, takes in views, and is optimised."""

from dataclasses import replace

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_step import MapParams, map_step, prune, seen_by
from sfgs_jax.slam.mapping._seeding import seed
from sfgs_jax.slam.state._gaussian_map import grow, move
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._step_info import Stages, untimed
from sfgs_jax.splatting import pair_capacity

_HEADROOM = 1.5
"""Room for pairs that a view gets, as a multiple of its need: the next views need a little more."""


def map_frame(
    mapping: MapState, state: SlamState, view: View | None, *, stages: Stages = untimed
) -> tuple[MapState, float]:
    """The map after a tracked frame: it follows the keyframes, takes in the view, and is optimised.

    Args:
        mapping: before the frame.
        state: the run after the frame was tracked.
        view: the frame as a view, if it is one.
        stages: times the stages `view` and `mapping`.

    Returns:
        The map state, and the loss on the view last rendered, before the step on it; NaN if none was.
    """
    config, camera, loss = state.config.mapping, state.mapping_camera, float("nan")
    with stages("view"):
        mapping = follow_keyframes(mapping, state.graph.poses, state.row_times)
        if view is not None:
            mapping, loss = insert_view(mapping, view, camera, config)
    with stages("mapping"):
        # The first step on a new view was part of its insertion.
        on_new = max(config.steps_per_view - 1, 0) if view is not None else 0
        for i in range(on_new + config.steps_per_frame):
            share = 1.0 if i < on_new else config.newest_share
            mapping, loss = optimise_once(mapping, camera, config, newest_share=share, seed=state.config.seed)
    return mapping, loss


def follow_keyframes(
    mapping: MapState, keyframe_poses: Float[np.ndarray, "n 7"], times: Float[np.ndarray, "3"] | None
) -> MapState:
    """The map where the keyframes are now: each Gaussian moves with its keyframe.

    Args:
        mapping: before.
        keyframe_poses: (n, 7) `T_world_cam` of the keyframes by now, as wxyz_xyz.
        times: (3,) of the camera's rows by now, as `MapState.times`.
    """
    old = mapping.keyframe_poses
    if not np.array_equal(old, keyframe_poses[: len(old)]):
        mapping = replace(mapping, map=move(mapping.map, old, keyframe_poses[: len(old)]))
    return replace(mapping, keyframe_poses=keyframe_poses, times=times)


def insert_view(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, float]:
    """Keep a view, and set Gaussians where the map lacks its surface. The map grows where it is full.

    The first step on the view renders it, and that rendering tells where surface is missing.

    Args:
        mapping: the map, which knows of the view's keyframe.
        view: the view to keep.
        camera: of the views.
        config: settings.

    Returns:
        The map state, and the loss of the map before.
    """
    stepped, missing, loss = step_on_view(mapping, view, camera, config)
    mapping = stepped if config.steps_per_view else replace(mapping, pair_capacity=stepped.pair_capacity)
    T_world_cam, keyframe = _pose(view, mapping), jnp.asarray(view.keyframe, jnp.int32)
    rgb, depth = seen_by(view, camera, _timing(mapping))
    while True:
        seeded, dropped = seed(
            mapping.map, rgb, depth, missing, camera, T_world_cam, keyframe, config.seeding
        )
        capacity = seeded.gaussians.valid.shape[0]
        if not int(dropped) or 2 * capacity > config.max_capacity:
            break
        mapping = replace(mapping, map=grow(mapping.map))
    mapping = replace(
        mapping,
        map=seeded,
        views=(*mapping.views, view),
        dropped_seeds=mapping.dropped_seeds + int(dropped),
    )
    return mapping, loss


def optimise_once(
    mapping: MapState, camera: Camera, config: MappingConfig, *, newest_share: float, seed: int = 0
) -> tuple[MapState, float]:
    """One map step on the newest view, or on one drawn uniformly.

    Args:
        mapping: the map and at least one view.
        camera: of the views.
        config: settings.
        newest_share: probability of the newest view.
        seed: of the choice of views.

    Returns:
        The map state after the step, and the loss before it.
    """
    draw = np.random.default_rng([seed, mapping.num_steps])
    newest = draw.random() < newest_share
    chosen = mapping.views[-1 if newest else draw.integers(len(mapping.views))]
    mapping, _, loss = step_on_view(mapping, chosen, camera, config)
    return mapping, loss


def step_on_view(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, Bool[Array, "h w"], float]:
    """One map step on a view, with as much room for pairs as it needs.

    Args:
        mapping: before.
        view: any view.
        camera: of the views.
        config: settings.

    Returns:
        The map state after the step, the pixels whose surface the map lacked before it, and its loss.
    """
    T_world_cam = _pose(view, mapping)
    while True:
        params = MapParams(
            camera, _timing(mapping), config.optimisation, config.seeding, mapping.pair_capacity
        )
        done = map_step(params, mapping.map, view, T_world_cam)
        if not int(done.overflow):
            break
        need = pair_capacity(mapping.map.gaussians, camera, T_world_cam, headroom=_HEADROOM)
        mapping = replace(mapping, pair_capacity=max(need, 2 * mapping.pair_capacity))
    num_steps, optimised = mapping.num_steps + 1, done.map
    if num_steps % config.prune_interval == 0:
        optimised = prune(optimised, config.prune_opacity)
    return replace(mapping, map=optimised, num_steps=num_steps), done.missing, float(done.loss)


def _pose(view: View, mapping: MapState) -> jaxlie.SE3:
    """`T_world_cam` of a view, by where its keyframe is."""
    keyframe = jaxlie.SE3(jnp.asarray(mapping.keyframe_poses[view.keyframe]))
    return se3.compose(keyframe, view.T_keyframe_cam)


def _timing(mapping: MapState) -> SensorTiming | None:
    return None if mapping.times is None else SensorTiming(*mapping.times)
