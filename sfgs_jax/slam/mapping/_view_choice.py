"""Choice of views: which frames the map is optimised against."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.geometry import (
    Camera,
    Frame,
    clean_depth,
    downscale_depth,
    downscale_rgb,
    has_depth,
    is_held_out,
    se3,
)
from sfgs_jax.slam.config import MappingConfig
from sfgs_jax.slam.state._frame_log import FrameLog
from sfgs_jax.slam.state._map_state import MapState, View
from sfgs_jax.slam.state._slam_state import SlamState


def image_shift(
    T_last_cam: Float[np.ndarray, "4 4"], depth: Float[np.ndarray, "h w"], camera: Camera
) -> float:
    """Largest motion of the image's corners from one frame to another, as a share of the image's width.

    Args:
        T_last_cam: from the later frame to the one before.
        depth: of the later frame, metres along z; 0 where missing. Its corners count as this deep on average.
        camera: intrinsics of both.
    """
    sample = depth[:: max(1, depth.shape[0] // 32), :: max(1, depth.shape[1] // 32)]
    known = sample[np.asarray(has_depth(sample))]
    distance = float(np.median(known)) if known.size else 1.0
    # `camera.matrix` would run a dozen small programs, and this is done for every frame.
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    right, bottom = camera.width - 1.0, camera.height - 1.0
    corners = np.array([[0, 0, 1], [right, 0, 1], [0, bottom, 1], [right, bottom, 1]])
    points = distance * corners @ np.linalg.inv(K).T
    moved = points @ T_last_cam[:3, :3].T + T_last_cam[:3, 3]
    if np.any(moved[:, 2] < 0.1 * distance):
        return np.inf
    there = moved @ K.T
    motion = there[:, :2] / there[:, 2:] - corners[:, :2]
    return float(np.max(np.linalg.norm(motion, axis=1))) / camera.width


def becomes_view(state: SlamState, log: FrameLog, frame: Frame, *, new_keyframe: bool) -> bool:
    """True if a frame that was just tracked becomes a view; see `view_is_due`.

    Args:
        state: the run, whose graph knows of the frame.
        log: with the frame as its newest.
        frame: the frame.
        new_keyframe: whether it is the newest keyframe.
    """
    shift, rows = 0.0, log.positions([state.last_view])
    if len(rows):
        pair = [int(rows[0]), -1]
        T_world_keyframe = se3.matrices_of(state.graph.poses[log.keyframes[pair]])
        T_world_cam = T_world_keyframe @ se3.matrices_of(log.motions[pair])
        T_last_cam = np.linalg.inv(T_world_cam[0]) @ T_world_cam[1]
        shift = image_shift(T_last_cam, np.asarray(frame.depth), state.camera)
    due = view_is_due(
        log.newest,
        state.last_view,
        [keyframe.frame for keyframe in state.graph.keyframes[-2:]],
        state.config.mapping,
        new_keyframe=new_keyframe,
        shift=shift,
    )
    return due and _has_room(state.mapping.views, int(log.keyframes[-1]), state.config.mapping)


def becomes_extra_view(mapping: MapState, number: int, last_view: int, config: MappingConfig) -> bool:
    """True if a frame that is no view is kept for the refinement alone.

    A map fits views that are far apart better than what lies between them. Extra ones cost no time while the
    run lasts, but the memory of their images, so their number is bounded. A camera that stays, and takes no
    views, keeps none.

    Args:
        mapping: the map before the frame.
        number: of the frame.
        last_view: number of the newest frame that became a view.
        config: settings.
    """
    since = number - last_view
    if not config.extra_interval or since % config.extra_interval or since >= config.view_interval:
        return False
    return 0 < len(mapping.views) < config.extra_until and not is_held_out(number)


def _has_room(views: tuple[View, ...], keyframe: int, config: MappingConfig) -> bool:
    """True if a keyframe may have one more view. So views grow with the area seen, not with the time."""
    return sum(view.keyframe == keyframe and not view.extra for view in views) < config.views_per_keyframe


def view_is_due(
    number: int,
    last_view: int,
    keyframes: list[int],
    config: MappingConfig,
    *,
    new_keyframe: bool,
    shift: float,
) -> bool:
    """True if a frame becomes a view: at an interval, once the image has moved on, and with most keyframes.

    A keyframe shows nothing new if an ordinary view was taken less than half an interval ago. Every eighth
    frame is kept for the evaluation; if it is a keyframe, the frame after it takes its place.

    Args:
        number: of the frame.
        last_view: number of the newest frame that became a view.
        keyframes: frame numbers of the newest two keyframes, or of the first alone.
        config: settings.
        new_keyframe: whether the frame is the newest keyframe.
        shift: of the image since that view; see `image_shift`.
    """
    if is_held_out(number):
        return False
    since = number - last_view
    new_keyframe |= is_held_out(number - 1) and keyframes[-1] == number - 1
    if shift >= config.max_view_shift:
        return True
    if not new_keyframe or len(keyframes) == 1:
        return new_keyframe or since >= config.view_interval
    ordinary_between = last_view > keyframes[-2]
    return not ordinary_between or 2 * since >= config.view_interval


def view_of(
    frame: Frame,
    factor: int,
    keyframe: int,
    T_keyframe_cam: jaxlie.SE3,
    number: int,
    twist: Float[Array | np.ndarray, "6"],
    *,
    extra: bool = False,
) -> View:
    """A view of a frame.

    Args:
        frame: colour image and depth; depth that is not finite or not positive counts as missing.
        factor: whole factor by which to reduce the images.
        keyframe: number of the keyframe that the view belongs to.
        T_keyframe_cam: its pose there.
        number: of the frame.
        twist: motion of the camera per second in its own frame; zeros where it is not known.
        extra: whether it is kept for the refinement alone.
    """
    rgb, depth, valid = _reduce(frame.rgb, frame.depth, frame.mask, factor)
    gain, correction = np.ones(3, np.float32), np.zeros(6, np.float32)
    return View(rgb, depth, valid, twist, keyframe, T_keyframe_cam, number, gain, correction, extra)


@partial(jax.jit, static_argnums=3)
def _reduce(
    rgb: Array | np.ndarray, depth: Array | np.ndarray, valid: Array | np.ndarray, factor: int
) -> tuple[Array, Array, Array]:
    small, (depth, _) = downscale_rgb(jnp.asarray(rgb), factor), clean_depth(jnp.asarray(depth))
    h, w, _ = small.shape
    blocks = jnp.asarray(valid)[: h * factor, : w * factor].reshape(h, factor, w, factor)
    whole = blocks.all(axis=(1, 3))
    return (
        jnp.round(small * 255).astype(jnp.uint8),
        jnp.where(whole, downscale_depth(depth, factor), 0),
        whole,
    )
