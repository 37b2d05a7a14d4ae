"""Choice of views: which frames the map is optimised against."""

from functools import partial

import jax
import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float

from sfgs_jax.geometry import Frame, clean_depth, downscale_depth, downscale_rgb, is_held_out
from sfgs_jax.slam.state._map_state import View


def view_is_due(
    number: int, last_view: int, keyframes: list[int], interval: int, *, new_keyframe: bool
) -> bool:
    """True if a frame becomes a view: at an interval, and with every keyframe that shows something new.

    A keyframe shows nothing new if an ordinary view was taken less than half an interval ago. Every eighth
    frame is kept for the evaluation; if it is a keyframe, the frame after it takes its place.

    Args:
        number: of the frame.
        last_view: number of the newest frame that became a view.
        keyframes: frame numbers of the newest two keyframes, or of the first alone.
        interval: frames between two views.
        new_keyframe: whether the frame is the newest keyframe.
    """
    if is_held_out(number):
        return False
    since = number - last_view
    new_keyframe |= is_held_out(number - 1) and keyframes[-1] == number - 1
    if not new_keyframe or len(keyframes) == 1:
        return new_keyframe or since >= interval
    ordinary_between = last_view > keyframes[-2]
    return not ordinary_between or 2 * since >= interval


def view_of(
    frame: Frame,
    factor: int,
    keyframe: int,
    T_keyframe_cam: jaxlie.SE3,
    number: int,
    twist: Float[Array | np.ndarray, "6"],
) -> View:
    """A view of a frame at the mapping resolution.

    Args:
        frame: colour image and depth; depth that is not finite or not positive counts as missing.
        factor: whole factor by which to reduce the images.
        keyframe: number of the keyframe that the view belongs to.
        T_keyframe_cam: its pose there.
        number: of the frame.
        twist: motion of the camera per second in its own frame; zeros where it is not known.
    """
    rgb, depth, valid = _reduce(frame.rgb, frame.depth, frame.mask, factor)
    return View(rgb, depth, valid, twist, keyframe, T_keyframe_cam, number, np.ones(3, np.float32))


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
