"""Updates of the map on the host: it follows the keyframes, takes in views, and is optimised."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from sfgs_jax.geometry import Camera, Trajectory, se3
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._paging import is_whole
from sfgs_jax.slam.mapping._view_insertion import insert_view
from sfgs_jax.slam.mapping._view_step import step_on_view
from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._gaussian_map import move
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._slam_state import SlamState
from sfgs_jax.slam.state._step_info import Stages, untimed

_DRAWS = 20
"""Views drawn before the newest is taken, where most of them show places that are paged out."""


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
