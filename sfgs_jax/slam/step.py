"""One step of the system: track a frame, take keyframes, optimise the map."""

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import jaxlie
import numpy as np

from sfgs_jax.geometry import Camera, Frame, clean_depth, downscale_depth, downscale_rgb
from sfgs_jax.slam.gaussian_map import GaussianMap, grow
from sfgs_jax.slam.optimisation import optimise, prune
from sfgs_jax.slam.seeding import seed, uncovered
from sfgs_jax.slam.state import Keyframe, Reference, SlamState
from sfgs_jax.slam.tracking import track
from sfgs_jax.splatting import RenderConfig, RenderOutput, pair_capacity, render

Stages = Callable[[str], AbstractContextManager[None]]
"""Gives, for the name of a stage, a context that lasts as long as the stage and times it."""


class StepInfo(NamedTuple):
    """What happened in a step.

    Attributes:
        T_world_cam: the frame's pose.
        tracked: whether that pose is known; if not, it is the last known one.
        new_reference: the frame became the one that the next are registered to.
        new_keyframe: the frame became a keyframe of the map.
        inlier_fraction: share of the frame's points matched in the reference.
        rmse: root mean square distance of the matched points, metres.
        loss: mapping loss before the last optimisation step; nan if there was none.
        dropped_seeds: Gaussians for which the map had no room.
    """

    T_world_cam: jaxlie.SE3
    tracked: bool
    new_reference: bool
    new_keyframe: bool
    inlier_fraction: float
    rmse: float
    loss: float
    dropped_seeds: int


def _untimed(name: str) -> AbstractContextManager[None]:
    return nullcontext()


def step(state: SlamState, frame: Frame, *, stages: Stages = _untimed) -> tuple[SlamState, StepInfo]:
    """Process one frame: its pose, then the map.

    The work is done by jit-compiled functions, compiled once per image size and map capacity.

    Args:
        state: the run so far, from `init` or an earlier step.
        frame: the next frame, of the size that the camera has.
        stages: times the stages `tracking`, `keyframe` and `mapping`.

    Raises:
        ValueError: the frame has another size than the camera.
    """
    if frame.depth.shape != state.camera.shape or frame.rgb.shape != (*state.camera.shape, 3):
        raise ValueError(
            f"The frame has colour {frame.rgb.shape} and depth {frame.depth.shape}, the camera is for images "
            f"of {state.camera.shape}: pass frames of one size, and init() a state for each size."
        )
    depth, _ = clean_depth(jnp.asarray(frame.depth))
    with stages("tracking"):
        found = track(state, depth)
    state = replace(
        state,
        T_world_cam=found.T_world_cam,
        T_previous_current=found.T_previous_current,
        num_frames=state.num_frames + 1,
    )
    new_keyframe = found.tracked and (found.new_reference or _keyframe_is_due(state))
    loss, dropped = float("nan"), 0
    if found.tracked:
        if found.new_reference:
            reference = Reference(found.cloud, found.T_world_cam)
            kept = (*state.references, reference)[-state.config.tracking.num_references :]
            state = replace(state, references=kept)
        if new_keyframe:
            with stages("keyframe"):
                state, dropped = _insert_keyframe(state, frame, depth)
        with stages("mapping"):
            mapping = state.config.mapping
            extra = mapping.steps_per_keyframe if new_keyframe else 0
            for i in range(extra + mapping.steps_per_frame):
                state, loss = optimise_once(state, newest=i < extra)
    info = StepInfo(
        found.T_world_cam,
        found.tracked,
        found.new_reference,
        new_keyframe,
        found.inlier_fraction,
        found.rmse,
        loss,
        dropped,
    )
    return state, info


def optimise_once(state: SlamState, *, newest: bool = False) -> tuple[SlamState, float]:
    """One optimisation step on the newest keyframe, or on one drawn from all.

    Returns:
        The state after it and the loss before it.
    """
    config = state.config.mapping
    draw = np.random.default_rng([state.config.seed, state.num_steps])
    newest = newest or draw.random() < config.newest_share
    chosen = state.keyframes[-1 if newest else draw.integers(len(state.keyframes))]
    while True:
        render_config = RenderConfig(pair_capacity=state.pair_capacity)
        optimised, loss, overflow = optimise(
            state.map,
            chosen.rgb,
            chosen.depth,
            state.mapping_camera,
            chosen.T_world_cam,
            config.optimisation,
            render_config,
        )
        if not int(overflow):
            break
        state = _with_room_for_pairs(state, chosen.T_world_cam)
    num_steps = state.num_steps + 1
    if num_steps % config.prune_interval == 0:
        optimised = prune(optimised, config.prune_opacity)
    return replace(state, map=optimised, num_steps=num_steps), float(loss)


def _keyframe_is_due(state: SlamState) -> bool:
    return state.num_frames - 1 - state.keyframes[-1].index >= state.config.mapping.keyframe_interval


def _insert_keyframe(state: SlamState, frame: Frame, depth: jax.Array) -> tuple[SlamState, int]:
    """Store the view and set Gaussians where the map lacks its surface, growing the map where it is full."""
    config = state.config.mapping
    camera = state.mapping_camera
    rgb, small_depth = _reduce(jnp.asarray(frame.rgb), depth, state.mapping_factor)
    while True:
        rendered = _render(
            state.map, camera, state.T_world_cam, RenderConfig(pair_capacity=state.pair_capacity)
        )
        if not int(rendered.overflow):
            break
        state = _with_room_for_pairs(state, state.T_world_cam)
    missing = uncovered(rendered, small_depth, config.seeding)
    while True:
        seeded, dropped = seed(
            state.map, rgb, small_depth, missing, camera, state.T_world_cam, config.seeding
        )
        capacity = seeded.gaussians.valid.shape[0]
        if not int(dropped) or 2 * capacity > config.max_capacity:
            break
        state = replace(state, map=grow(state.map))
    keyframe = Keyframe(
        rgb=jnp.round(rgb * 255).astype(jnp.uint8),
        depth=small_depth,
        T_world_cam=state.T_world_cam,
        index=state.num_frames - 1,
    )
    kept = (*state.keyframes, keyframe)[-config.keyframe_capacity :]
    return replace(state, map=seeded, keyframes=kept), int(dropped)


def _with_room_for_pairs(state: SlamState, T_world_cam: jaxlie.SE3) -> SlamState:
    """The state with room for the pairs of a view that did not fit, and half as much again."""
    need = pair_capacity(state.map.gaussians, state.mapping_camera, T_world_cam, headroom=1.5)
    return replace(state, pair_capacity=max(need, 2 * state.pair_capacity))


@eqx.filter_jit
def _render(
    gaussian_map: GaussianMap, camera: Camera, T_world_cam: jaxlie.SE3, render_config: RenderConfig
) -> RenderOutput:
    return render(gaussian_map.gaussians, camera, T_world_cam, config=render_config)


@partial(jax.jit, static_argnums=2)
def _reduce(rgb: jax.Array, depth: jax.Array, factor: int) -> tuple[jax.Array, jax.Array]:
    return downscale_rgb(rgb, factor), downscale_depth(depth, factor)
