"""Change of brightness from one frame to the next, by the surface that both show; on the host."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import Camera, has_depth

_BLOCK = 16
"""Side of the blocks of pixels that are compared by their means, pixels."""
_LEAST_BLOCKS = 20
"""Blocks that have to be seen in both images for their change to mean anything."""
_LARGEST_CHANGE = 1.0
"""Largest change of a logarithm that is believed: more is a flash, or a covered lens."""


@checked
def block_means(rgb: Float[np.ndarray, "H W 3"]) -> Float[np.ndarray, "h w 3"]:
    """Mean colours of blocks of 16 x 16 pixels; what is left over at the right and at the bottom is cut off.

    Args:
        rgb: colours.
    """
    h, w = max(rgb.shape[0] // _BLOCK, 1), max(rgb.shape[1] // _BLOCK, 1)
    whole = rgb[: h * _BLOCK, : w * _BLOCK]
    return cv2.resize(np.asarray(whole, np.float32), (w, h), interpolation=cv2.INTER_AREA)


@checked
def brightness_change(
    before: Float[np.ndarray, "h w 3"],
    now: Float[np.ndarray, "h w 3"],
    depth: Float[np.ndarray, "H W"],
    valid: Bool[np.ndarray, "H W"],
    camera: Camera,
    T_before_now: Float[np.ndarray, "4 4"],
) -> Float[np.ndarray, "3"]:
    """Logarithm of each channel's brightness now over that before; zeros where the frames share too little.

    A ratio of mean colours, as in `fitted_gain`.

    Args:
        before: mean colours of the earlier frame's blocks.
        now: of this frame's.
        depth: of this frame, metres; not finite or not positive counts as missing.
        valid: pixels that hold an image, in both frames.
        camera: intrinsics of the whole images.
        T_before_now: from this frame's camera to the earlier one's.
    """
    none = np.zeros(3, np.float32)
    h, w, _ = now.shape
    half = _BLOCK // 2
    z, seen = (x[half : h * _BLOCK : _BLOCK, half : w * _BLOCK : _BLOCK] for x in (depth, valid))
    if z.shape != (h, w):  # images smaller than a block
        return none
    fx, fy, cx, cy = (float(x) for x in (camera.fx, camera.fy, camera.cx, camera.cy))
    v, u = np.mgrid[half : h * _BLOCK : _BLOCK, half : w * _BLOCK : _BLOCK]
    known = seen & has_depth(z)
    z = np.where(known, z, 1.0)
    points = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=-1)
    there = points @ T_before_now[:3, :3].T + T_before_now[:3, 3]
    front = np.maximum(there[..., 2], 1e-3)
    # The centre of a block lies between two pixels; pixels of the small image are blocks.
    column = (fx * there[..., 0] / front + cx - half) / _BLOCK
    row = (fy * there[..., 1] / front + cy - half) / _BLOCK
    known &= (there[..., 2] > 1e-3) & (column >= 0) & (column <= w - 1) & (row >= 0) & (row <= h - 1)
    if known.sum() < _LEAST_BLOCKS:
        return none
    places = (np.where(known, x, 0).astype(np.float32) for x in (column, row))
    shown = cv2.remap(before, *places, interpolation=cv2.INTER_LINEAR)
    sums = np.stack([shown[known].sum(axis=0), now[known].sum(axis=0)]) + 1e-3
    change = np.log(sums[1] / sums[0])
    return np.where(np.abs(change) < _LARGEST_CHANGE, change, 0).astype(np.float32)
