"""How close a rendered image is to the recorded one, by the protocols that papers use.

| protocol | frames | pixels |
|---|---|---|
| `all` | every one | every one |
| `gs_icp` | every one | those without input depth are set to zero in both images, and count |
| `splatam` | the first and every fifth | the same; PSNR is taken per colour channel and averaged |
| `held_out` | those that were not used for mapping | every one |

Setting pixels to zero in both images makes them agree, which raises the figures of real recordings: compare
only figures of one protocol. Figures are means over frames of each frame's figure. SplaTAM prints
MS-SSIM; here `ssim` is the plain one in every protocol.

Source: the evaluation code of GS-ICP-SLAM (Ha et al., ECCV 2024) and SplaTAM (Keetha et al., CVPR 2024).
"""

from typing import Literal, assert_never, get_args

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.splatting import ssim

Protocol = Literal["all", "gs_icp", "splatam", "held_out"]
"""Name of a way to average image metrics; see the table at the top of the module."""

PROTOCOLS: tuple[Protocol, ...] = get_args(Protocol)

SPLATAM_EVERY = 5
"""SplaTAM scores the first frame and then the last of every five."""

# Equal images would have an infinite PSNR, which no mean and no JSON file can hold.
_SMALLEST_MSE = 1e-10


def psnr(a: Float[Array, "*shape"], b: Float[Array, "*shape"]) -> Float[Array, ""]:
    """Peak signal-to-noise ratio of images in [0, 1], dB; equal images have 100."""
    return _decibels(jnp.mean((a - b) ** 2))


def _decibels(mse: Float[Array, "*n"]) -> Float[Array, "*n"]:
    return -10 * jnp.log10(jnp.maximum(mse, _SMALLEST_MSE))


def masked_images(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"]
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
    """Both images with zeros where the recording has no depth, as `gs_icp` and `splatam` compare them."""
    has_depth = (depth > 0)[..., None]
    return jnp.where(has_depth, rendered, 0), jnp.where(has_depth, rgb, 0)


def psnr_by_protocol(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], depth: Float[Array, "H W"]
) -> dict[Protocol, Float[Array, ""]]:
    """PSNR of one frame, dB, as every protocol takes it; whether the frame belongs to one, `frames_of` says.

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
    """SSIM of one frame as every protocol takes it; arguments as for `psnr_by_protocol`."""
    rendered = jnp.clip(rendered, 0, 1)
    whole, masked = ssim(rendered, rgb), ssim(*masked_images(rendered, rgb, depth))
    return {"all": whole, "gs_icp": masked, "splatam": masked, "held_out": whole}


def frames_of(
    protocol: Protocol, num_frames: int, keyframes: Int[np.ndarray, " k"]
) -> Bool[np.ndarray, " num_frames"]:
    """Which frames of a recording belong to a protocol.

    Args:
        protocol: its name.
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
