"""PSNR and SSIM of a rendered image against the recorded one, by the protocols that papers use.

Protocol `all`: every pixel of every frame.
Protocol `depth`: the pixels with input depth of every frame.
Protocol `gs_icp`: every frame. Pixels without input depth are set to zero in both images, and count.
Protocol `gs_icp_exposure`: the same after each rendered image was given the exposure that fits best.
Protocol `gs_icp_raw`: `gs_icp` of the map in its own colours, without the gains that the run has estimated.
Protocol `splatam`: the first and every fifth frame, with the same zeros; PSNR is a mean over channels, in dB.
Protocol `views`: every pixel of the frames that were used for mapping.
Protocol `held_out`: every pixel of every eighth frame, which no run uses for mapping.

All but `gs_icp_raw` compare the map as the camera showed it at that time: with the run's estimate of its
exposure, which comes from the views before and after.

Pixels beyond a lens's field of view hold no image; they count as pixels without depth, or not at all.

Pixels that are zero in both images agree, which raises the figures of real recordings. So only figures of one
protocol can be compared. Figures are means over frames of each frame's figure. SplaTAM prints MS-SSIM; here
`ssim` is plain SSIM in every protocol.

Source: the evaluation code of GS-ICP-SLAM (Ha et al., ECCV 2024) and SplaTAM (Keetha et al., CVPR 2024).
"""

from typing import Literal, assert_never, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from sfgs_jax.arrays import checked
from sfgs_jax.geometry import is_held_out
from sfgs_jax.splatting import ssim

Protocol = Literal["all", "depth", "gs_icp", "gs_icp_exposure", "gs_icp_raw", "splatam", "views", "held_out"]
"""Name of a choice of frames and pixels for image metrics; docs/evaluation.md describes them."""

PROTOCOLS: tuple[Protocol, ...] = get_args(Protocol)
"""Names of the protocols."""

SPLATAM_EVERY = 5
"""SplaTAM scores the first frame and then the last of every five."""

# Equal images would have an infinite PSNR, which no mean and no JSON file can hold.
_SMALLEST_MSE = 1e-10


@checked
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
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], mask: Bool[Array, "H W"]
) -> tuple[Float[Array, "H W 3"], Float[Array, "H W 3"]]:
    """Both images with zeros outside the mask, as `gs_icp` and `splatam` compare them.

    Args:
        rendered: image of the map.
        rgb: the recorded image.
        mask: pixels with recorded depth.
    """
    return jnp.where(mask[..., None], rendered, 0), jnp.where(mask[..., None], rgb, 0)


def with_exposure_of(
    rendered: Float[Array, "H W 3"], rgb: Float[Array, "H W 3"], mask: Bool[Array, "H W"]
) -> Float[Array, "H W 3"]:
    """A rendered image with the gain and offset of each channel that bring it closest to the recorded one.

    Args:
        rendered: image of the map.
        rgb: the recorded image.
        mask: pixels to fit.
    """
    weights = mask[..., None].astype(rendered.dtype)
    count = jnp.maximum(jnp.sum(weights), 1)
    means = [jnp.sum(weights * image, axis=(0, 1), keepdims=True) / count for image in (rendered, rgb)]
    off = weights * (rendered - means[0])
    variance = jnp.sum(off**2, axis=(0, 1), keepdims=True)
    covariance = jnp.sum(off * (rgb - means[1]), axis=(0, 1), keepdims=True)
    # An image of one colour has no gain to find.
    gain = jnp.where(variance > 0, covariance / jnp.where(variance > 0, variance, 1), 1)
    return jnp.clip(gain * (rendered - means[0]) + means[1], 0, 1)


@checked
@jax.jit
def psnr_by_protocol(
    rendered: Float[Array, "H W 3"],
    rgb: Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    valid: Bool[Array, "H W"],
    raw: Float[Array, "H W 3"] | None = None,
) -> dict[Protocol, Float[Array, ""]]:
    """PSNR of one frame in dB, by protocol; `frames_of` says which frames belong to a protocol.

    Args:
        rendered: image of the map as the camera showed it; values outside [0, 1] are clipped.
        rgb: the recorded image in [0, 1].
        depth: recorded depth in metres, 0 where missing.
        valid: pixels that hold an image.
        raw: image of the map in its own colours; the same as `rendered` if not given.
    """
    raw = jnp.clip(rendered if raw is None else raw, 0, 1)
    rendered, seen = jnp.clip(rendered, 0, 1), valid & (depth > 0)
    exposed = with_exposure_of(rendered, rgb, seen)
    channel_mse, exposed_mse, raw_mse = (
        jnp.mean(jnp.where(seen[..., None], image - rgb, 0) ** 2, axis=(0, 1))
        for image in (rendered, exposed, raw)
    )
    whole = _decibels(_mean_where(valid, (rendered - rgb) ** 2))
    return {
        "all": whole,
        "depth": _decibels(_mean_where(seen, (rendered - rgb) ** 2)),
        "gs_icp": _decibels(jnp.mean(channel_mse)),
        "gs_icp_exposure": _decibels(jnp.mean(exposed_mse)),
        "gs_icp_raw": _decibels(jnp.mean(raw_mse)),
        "splatam": jnp.mean(_decibels(channel_mse)),
        "views": whole,
        "held_out": whole,
    }


def _mean_where(mask: Bool[Array, "H W"], values: Float[Array, "H W c"]) -> Float[Array, ""]:
    """Mean over the mask and the channels; 0 if it is empty."""
    count = values.shape[-1] * jnp.sum(mask, dtype=values.dtype)
    return jnp.sum(jnp.where(mask[..., None], values, 0)) / jnp.maximum(count, 1)


@checked
@jax.jit
def ssim_by_protocol(
    rendered: Float[Array, "H W 3"],
    rgb: Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    valid: Bool[Array, "H W"],
    raw: Float[Array, "H W 3"] | None = None,
) -> dict[Protocol, Float[Array, ""]]:
    """SSIM of one frame, by protocol. Arguments as of `psnr_by_protocol`."""
    raw = jnp.clip(rendered if raw is None else raw, 0, 1)
    rendered, seen = jnp.clip(rendered, 0, 1), valid & (depth > 0)
    whole, masked = ssim(rendered, rgb, valid), ssim(*masked_images(rendered, rgb, seen))
    exposed = ssim(*masked_images(with_exposure_of(rendered, rgb, seen), rgb, seen))
    return {
        "all": whole,
        "depth": ssim(rendered, rgb, seen),
        "gs_icp": masked,
        "gs_icp_exposure": exposed,
        "gs_icp_raw": ssim(*masked_images(raw, rgb, seen)),
        "splatam": masked,
        "views": whole,
        "held_out": whole,
    }


@checked
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
        case "all" | "depth" | "gs_icp" | "gs_icp_exposure" | "gs_icp_raw":
            return np.ones(num_frames, bool)
        case "splatam":
            index = np.arange(num_frames)
            return (index == 0) | ((index + 1) % SPLATAM_EVERY == 0)
        case "held_out":
            kept = np.asarray([is_held_out(index) for index in range(num_frames)], bool)
            return kept & ~np.isin(np.arange(num_frames), keyframes)
        case "views":
            return np.isin(np.arange(num_frames), keyframes)
        case _:
            assert_never(protocol)
