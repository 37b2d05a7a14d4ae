"""PSNR and SSIM of a rendered image against the recorded one, by the protocols that papers use.

Protocol `all`: every pixel of every frame.
Protocol `gs_icp`: every frame. Pixels without input depth are set to zero in both images, and count.
Protocol `splatam`: the first and every fifth frame, with the same zeros; PSNR is a mean over channels, in dB.
Protocol `held_out`: every pixel of the frames that were not used for mapping.

Pixels that are zero in both images agree, which raises the figures of real recordings. So only figures of one
protocol can be compared. Figures are means over frames of each frame's figure. SplaTAM prints MS-SSIM; here
`ssim` is plain SSIM in every protocol.

Source: the evaluation code of GS-ICP-SLAM (Ha et al., ECCV 2024) and SplaTAM (Keetha et al., CVPR 2024).
"""

from typing import Literal, assert_never, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.splatting import ssim

Protocol = Literal["all", "gs_icp", "splatam", "held_out"]
"""Name of a choice of frames and pixels for image metrics; docs/evaluation.md describes the four."""

PROTOCOLS: tuple[Protocol, ...] = get_args(Protocol)
"""Names of the protocols."""

SPLATAM_EVERY = 5
"""SplaTAM scores the first frame and then the last of every five."""

# Equal images would have an infinite PSNR, which no mean and no JSON file can hold.
_SMALLEST_MSE = 1e-10


def psnr(a: Float[Array, "*shape"], b: Float[Array, "*shape"]) -> Float[Array, ""]:
    """Peak signal-to-noise ratio of two images, dB; equal images have 100.

    Args:
        a: values in [0, 1].
        b: values in [0, 1].
    """
    return _decibels(jnp.mean((a - b) ** 2))


def _decibels(mse: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return -10 * jnp.log10(jnp.maximum(mse, _SMALLEST_MSE))


def masked_images(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"]
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
    """Both images with zeros at pixels without recorded depth, as `gs_icp` and `splatam` compare them.

    Args:
        rendered: image of the map.
        rgb: the recorded image.
        depth: recorded depth in metres, 0 where missing.
    """
    has_depth = (depth > 0)[..., None]
    return jnp.where(has_depth, rendered, 0), jnp.where(has_depth, rgb, 0)


def psnr_by_protocol(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"]
) -> dict[Protocol, Float[Array, ""]]:
    """PSNR of one frame in dB, by protocol; `frames_of` says which frames belong to a protocol.

    Args:
        rendered: image of the map at the frame's pose; values outside [0, 1] are clipped.
        rgb: the recorded image in [0, 1].
        depth: recorded depth in metres, 0 where missing.
    """
    rendered = jnp.clip(rendered, 0, 1)
    masked_rendered, masked_rgb = masked_images(rendered, rgb, depth)
    channel_mse = jnp.mean((masked_rendered - masked_rgb) ** 2, axis=(0, 1))
    whole = psnr(rendered, rgb)
    return {
        "all": whole,
        "gs_icp": _decibels(jnp.mean(channel_mse)),
        "splatam": jnp.mean(_decibels(channel_mse)),
        "held_out": whole,
    }


def ssim_by_protocol(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"]
) -> dict[Protocol, Float[Array, ""]]:
    """SSIM of one frame, by protocol. Arguments as of `psnr_by_protocol`."""
    rendered = jnp.clip(rendered, 0, 1)
    whole, masked = ssim(rendered, rgb), ssim(*masked_images(rendered, rgb, depth))
    return {"all": whole, "gs_icp": masked, "splatam": masked, "held_out": whole}


def frames_of(
    protocol: Protocol, num_frames: int, keyframes: Int[np.ndarray, " k"]
) -> Bool[np.ndarray, " num_frames"]:
    """Mask of the frames of a recording that belong to a protocol.

    Args:
        protocol: name of the protocol.
        num_frames: length of the recording.
        keyframes: indices of the frames that were used for mapping.
    """
    match protocol:
        case "all" | "gs_icp":
            return np.ones(num_frames, bool)
        case "splatam":
            index = np.arange(num_frames)
            return (index == 0) | ((index + 1) % SPLATAM_EVERY == 0)
        case "held_out":
            return ~np.isin(np.arange(num_frames), keyframes)
        case _:
            assert_never(protocol)
