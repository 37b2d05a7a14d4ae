"""The map beside the tracker: new views, new Gaussians, optimisation steps."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.geometry import Camera, Frame, clean_depth, downscale_depth, downscale_rgb, se3
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.gaussian_map import grow, move
from sfgs_jax.slam.optimisation import optimise, prune
from sfgs_jax.slam.seeding import seed
from sfgs_jax.slam.state import MapState, View
from sfgs_jax.splatting import RenderConfig, pair_capacity


def view_of(
    frame: Frame,
    factor: int,
    keyframe: int,
    T_keyframe_cam: jaxlie.SE3,
    number: int,
) -> View:
    """A view of a frame at the mapping resolution.

    Args:
        frame: of its depth, what is not finite or not positive counts as missing.
        factor: whole factor by which to reduce the images.
        keyframe: number of the keyframe that the view belongs to.
        T_keyframe_cam: its pose there.
        number: of the frame.
    """
    rgb, small = _reduce(frame.rgb, frame.depth, factor)
    return View(rgb, small, keyframe, T_keyframe_cam, number)


def follow_keyframes(mapping: MapState, keyframe_poses: Float[np.ndarray, "n 7"]) -> MapState:
    """The map where the keyframes are now: each Gaussian has moved with its own."""
    old = mapping.keyframe_poses
    if not np.array_equal(old, keyframe_poses[: len(old)]):
        mapping = replace(mapping, map=move(mapping.map, old, keyframe_poses[: len(old)]))
    return replace(mapping, keyframe_poses=keyframe_poses)


def insert_view(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, float]:
    """Keep a view, and set Gaussians where the map lacks its surface, growing the map where it is full.

    The rendering that tells where is the one of the first optimisation step on the view.

    Args:
        mapping: the map, which knows of the view's keyframe.
        view: what to keep.
        camera: of the views.
        config: settings.

    Returns:
        The map state, and the loss of the map before.
    """
    stepped, missing, loss = _step(mapping, view, camera, config)
    mapping = stepped if config.steps_per_view else replace(mapping, pair_capacity=stepped.pair_capacity)
    depth, T_world_cam = jnp.asarray(view.depth), _pose(view, mapping)
    rgb, keyframe = _colours(view.rgb), jnp.asarray(view.keyframe, jnp.int32)
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
    """One optimisation step on the newest view, or on one drawn from all.

    Args:
        mapping: the map and at least one view.
        camera: of the views.
        config: settings.
        newest_share: probability that the newest view is taken; else one is drawn uniformly.
        seed: of the choice of views.

    Returns:
        The map state after it and the loss before it.
    """
    draw = np.random.default_rng([seed, mapping.num_steps])
    newest = draw.random() < newest_share
    chosen = mapping.views[-1 if newest else draw.integers(len(mapping.views))]
    mapping, _, loss = _step(mapping, chosen, camera, config)
    return mapping, loss


def _step(
    mapping: MapState, view: View, camera: Camera, config: MappingConfig
) -> tuple[MapState, Bool[Array, "h w"], float]:
    """An optimisation step on a view.

    Returns:
        The map state after it, where the map before it lacked the view's surface, and its loss.
    """
    T_world_cam = _pose(view, mapping)
    while True:
        done = optimise(
            mapping.map,
            jnp.asarray(view.rgb),
            jnp.asarray(view.depth),
            camera,
            T_world_cam,
            config.optimisation,
            config.seeding,
            RenderConfig(pair_capacity=mapping.pair_capacity),
        )
        if not int(done.overflow):
            break
        mapping = _with_room_for_pairs(mapping, camera, T_world_cam)
    num_steps, optimised = mapping.num_steps + 1, done.map
    if num_steps % config.prune_interval == 0:
        optimised = prune(optimised, config.prune_opacity)
    return replace(mapping, map=optimised, num_steps=num_steps), done.missing, float(done.loss)


def warm_up(mapping: MapState, keyframe_poses: Float[np.ndarray, "n 7"], config: MappingConfig) -> None:
    """Compile what only some of the later steps need."""
    move(mapping.map, keyframe_poses, keyframe_poses)
    prune(mapping.map, config.prune_opacity)


def _pose(view: View, mapping: MapState) -> jaxlie.SE3:
    """`T_world_cam` of a view, by where its keyframe is."""
    keyframe = jaxlie.SE3(jnp.asarray(mapping.keyframe_poses[view.keyframe]))
    return se3.compose(keyframe, view.T_keyframe_cam)


def _with_room_for_pairs(mapping: MapState, camera: Camera, T_world_cam: jaxlie.SE3) -> MapState:
    """The state with room for the pairs of a view that did not fit, and half as much again."""
    need = pair_capacity(mapping.map.gaussians, camera, T_world_cam, headroom=1.5)
    return replace(mapping, pair_capacity=max(need, 2 * mapping.pair_capacity))


@partial(jax.jit, static_argnums=2)
def _reduce(rgb: Array | np.ndarray, depth: Array | np.ndarray, factor: int) -> tuple[jax.Array, jax.Array]:
    small, (depth, _) = downscale_rgb(jnp.asarray(rgb), factor), clean_depth(jnp.asarray(depth))
    return jnp.round(small * 255).astype(jnp.uint8), downscale_depth(depth, factor)


@jax.jit
def _colours(rgb: jax.Array) -> jax.Array:
    return rgb.astype(jnp.float32) / 255
