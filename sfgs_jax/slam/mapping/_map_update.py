"""Updates of the map on the host: it follows the keyframes, takes in views, and is optimised."""

from concurrent.futures import Future
from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import Background, bucket, doubled
from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.sensors import SensorTiming, with_gain
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_step import (
    MapParams,
    MapStep,
    compare_with_map,
    map_step,
    prune,
    seen_by,
)
from sfgs_jax.slam.mapping._paging import is_whole, with_surface_of
from sfgs_jax.slam.mapping._seeding import seed
from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._gaussian_map import empty_map, grow, keyframe_room, move
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._step_info import Stages, untimed

_DRAWS = 20
"""Views drawn before the newest is taken, where most of them show places that are paged out."""

_background = Background()


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
        on_new = max(config.steps_per_view - 1, 0) if view is not None and not view.extra else 0
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


def follow_trajectory(mapping: MapState, log: FrameLog, trajectory: Trajectory) -> MapState:
    """The map with its views where the trajectory has their frames.

    While a run lasts, a view stays where it is in its keyframe. Later frames between two keyframes share the
    correction of the motion between them, so at the end their views do too. The
    correction by a view's image stays beside that.

    Args:
        mapping: the map, which knows where the keyframes are.
        log: the frames.
        trajectory: their poses, without the views' corrections.
    """
    rows = {number: row for row, number in enumerate(log.numbers.tolist())}
    T_world_keyframe = se3.matrices_of(mapping.keyframe_poses)

    def moved(view: View) -> View:
        pose = np.linalg.inv(T_world_keyframe[view.keyframe]) @ trajectory.poses[rows[view.frame]]
        return replace(view, T_keyframe_cam=se3.from_matrix(pose))

    return replace(
        mapping, views=tuple(moved(view) if view.frame in rows else view for view in mapping.views)
    )


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
        rooms.append((capacity, pairs, _view_room(seen + 1)))
    begun = [
        _background.once((*room, camera.shape, config), _use_room, room, mapping, camera, config)
        for room in rooms
    ]
    poses, keyframes = mapping.keyframe_poses, keyframe_room(len(mapping.keyframe_poses))
    if len(poses) > keyframes * 3 // 4:
        more = np.repeat(poses[-1:], 2 * keyframes, axis=0)
        begun.append(_background.once((capacity, 2 * keyframes), move, mapping.map, more, more))
    return [future for future in begun if future is not None]


def _view_room(count: int) -> int:
    """Room for so many Gaussians in view: half an octave more when it is short."""
    return bucket(count, steps=2)


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
    T_world_cam, keyframe = _pose(view, mapping), jnp.asarray(view.keyframe, jnp.int32)
    rgb, depth = seen_by(view, camera, _timing(mapping))
    rgb = with_gain(rgb, 1 / done.seed_gain)
    while True:
        seeded, dropped = seed(
            mapping.map, rgb, depth, done.missing, camera, T_world_cam, keyframe, config.seeding
        )
        capacity = seeded.gaussians.valid.shape[0]
        if not int(dropped) or 2 * capacity > config.max_capacity:
            break
        mapping = replace(mapping, map=grow(mapping.map))
    mapping = replace(
        mapping,
        map=seeded,
        dropped_seeds=mapping.dropped_seeds + int(dropped),
    )
    return mapping, done


def _exposed_as_last(view: View, mapping: MapState) -> View:
    """The view with the newest one's gain: a camera's exposure changes slowly."""
    return replace(view, gain=mapping.views[-1].gain) if mapping.views else view


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
    number = -1 if newest else _drawn(mapping, camera, draw)
    mapping, done = step_on_view(mapping, number, camera, config)
    return mapping, float(done.loss)


def _drawn(mapping: MapState, camera: Camera, draw: np.random.Generator) -> int:
    """Number of a view drawn uniformly from those whose whole surface is in the map; else the newest."""
    for _ in range(_DRAWS):
        number = int(draw.integers(len(mapping.views)))
        if not mapping.submaps or is_whole(mapping, mapping.views[number], camera):
            return number
    return -1


def step_on_view(
    mapping: MapState,
    number: int,
    camera: Camera,
    config: MappingConfig,
    *,
    rate: float = 1.0,
    learn: bool = True,
    view_rate: float = 0.0,
) -> tuple[MapState, MapStep]:
    """One map step on a view, with as much room for Gaussians and pairs as it needs.

    Args:
        mapping: before.
        number: of the view; -1 is the newest.
        camera: of the views.
        config: settings.
        rate: factor on the learning rates.
        learn: take the step; otherwise the view is only compared with the map.
        view_rate: factor on the step of the view's pose; with 0 it stays.

    Returns:
        The map state after the step, and what the step found.
    """
    view = mapping.views[number]
    T_world_cam, mean_gain = _pose(view, mapping), _mean_gain(mapping, config)
    while True:
        params = MapParams(
            camera=camera,
            timing=_timing(mapping),
            mean_gain=mean_gain,
            rate=jnp.asarray(rate, jnp.float32),
            config=config.optimisation,
            seeding=config.seeding,
            pair_capacity=mapping.pair_capacity,
            view_capacity=mapping.view_capacity,
        )
        done = (map_step if learn else compare_with_map)(params, mapping.map, view, T_world_cam)
        if not int(done.overflow):
            break
        mapping = replace(
            mapping,
            pair_capacity=doubled(mapping.pair_capacity, int(done.needed)),
            view_capacity=max(mapping.view_capacity, _view_room(int(done.in_view))),
        )
    if not learn:
        return mapping, done
    num_steps, optimised = mapping.num_steps + 1, done.map
    if num_steps % config.prune_interval == 0:
        optimised = prune(optimised, config.prune_opacity)
    views = list(mapping.views)
    correction = _corrected(view, done, view_rate * config.optimisation.learning_rates.poses)
    views[number] = replace(view, gain=np.asarray(done.gain), correction=correction)
    return replace(mapping, map=optimised, views=tuple(views), num_steps=num_steps), done


def _pose(view: View, mapping: MapState) -> jaxlie.SE3:
    """`T_world_cam` of a view, by where its keyframe is and by what its image told."""
    keyframe = jaxlie.SE3(jnp.asarray(mapping.keyframe_poses[view.keyframe]))
    return _placed(keyframe, view.T_keyframe_cam, jnp.asarray(view.correction))


@jax.jit
def _placed(T_world_keyframe: jaxlie.SE3, T_keyframe_cam: jaxlie.SE3, correction: Array) -> jaxlie.SE3:
    return se3.compose(se3.compose(T_world_keyframe, T_keyframe_cam), se3.exp(correction))


def _corrected(view: View, done: MapStep, length: float) -> Float[np.ndarray, "6"]:
    """A view's correction after a step of this length along each direction, against the gradient.

    A view is seen a few times only, too few for the size of the gradient to tell how far to go. As the
    lengths decay, the steps come to rest. Corrections are small, so their tangents add up.

    Source: Riedmiller and Braun, A direct adaptive method for faster backpropagation learning (1993), for
    steps by the sign of the gradient.
    """
    downhill = -np.sign(np.nan_to_num(np.asarray(done.pose_gradient)))
    return np.asarray(view.correction + length * downhill, np.float32)


def _mean_gain(mapping: MapState, config: MappingConfig) -> Float[Array, "3"] | None:
    if not config.optimisation.estimate_exposure:
        return None
    return jnp.asarray(np.stack([view.gain for view in mapping.views]).mean(axis=0))


def _timing(mapping: MapState) -> SensorTiming | None:
    return None if mapping.times is None else SensorTiming(*mapping.times)
