"""A map step on one of the map's views, with the room that it needs."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.arrays import bucket, doubled
from sfgs_jax.geometry import Camera, se3
from sfgs_jax.sensors import SensorTiming
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.mapping._map_step import MapParams, MapStep, compare_with_map, map_step, prune
from sfgs_jax.slam.state._map_state import MapState, View


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
    T_world_cam, exposed = pose_of(view, mapping), config.optimisation.estimate_exposure
    while True:
        params = MapParams(
            camera=camera,
            timing=timing_of(mapping),
            mean_gain=jnp.asarray(_mean_gain(mapping)) if exposed else None,
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
            view_capacity=max(mapping.view_capacity, view_room(int(done.in_view))),
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


def pose_of(view: View, mapping: MapState) -> jaxlie.SE3:
    """`T_world_cam` of a view, by where its keyframe is and by what its image told."""
    keyframe = jaxlie.SE3(jnp.asarray(mapping.keyframe_poses[view.keyframe]))
    return _placed(keyframe, view.T_keyframe_cam, jnp.asarray(view.correction))


@jax.jit
def _placed(T_world_keyframe: jaxlie.SE3, T_keyframe_cam: jaxlie.SE3, correction: Array) -> jaxlie.SE3:
    return se3.compose(se3.compose(T_world_keyframe, T_keyframe_cam), se3.exp(correction))


def _corrected(view: View, done: MapStep, length: float) -> Float[np.ndarray, "6"]:
    """A view's correction after a step of this length along each direction, against the gradient.

    A view is seen a few times only, too few for the size of the gradient to tell how far to go. The
    lengths decay, so that the steps come to rest. Corrections are small, so their tangents add up.

    Source: Riedmiller and Braun, A direct adaptive method for faster backpropagation learning (1993), for
    steps by the sign of the gradient.
    """
    downhill = -np.sign(np.nan_to_num(np.asarray(done.pose_gradient)))
    return np.asarray(view.correction + length * downhill, np.float32)


def _mean_gain(mapping: MapState) -> Float[np.ndarray, "3"]:
    return np.stack([view.gain for view in mapping.views]).mean(axis=0)


def timing_of(mapping: MapState) -> SensorTiming | None:
    """Times of the camera's rows; None if images count as taken at once."""
    return None if mapping.times is None else SensorTiming(*mapping.times)


def view_room(count: int) -> int:
    """Room for so many Gaussians in view: half an octave more when it is short."""
    return bucket(count, steps=2)
