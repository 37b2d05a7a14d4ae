"""Image metrics of a map over a whole recording, one frame in memory at a time."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording, Selection, prefetch
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.images._frame_figures import FrameFigures
from sfgs_jax.evaluation.images._image_metrics import (
    PROTOCOLS,
    Protocol,
    frames_of,
    masked_images,
    psnr_by_protocol,
    ssim_by_protocol,
)
from sfgs_jax.evaluation.images._lpips import LpipsWeights, lpips
from sfgs_jax.evaluation.images._map_renderer import MapRenderer
from sfgs_jax.splatting import Gaussians, RenderOutput

LPIPS_PROTOCOL: Protocol = "splatam"
"""The only protocol of LPIPS, which takes several times as long as the other metrics together."""

OPAQUE = 0.5
"""Accumulated opacity below which a pixel shows too little of the map for a depth."""


@dataclass
class ImageFigures:
    """Figures of every scored frame.

    Attributes:
        frames: those that could be scored.
        unreadable: frames with a pose that could not be decoded.
    """

    frames: list[FrameFigures] = field(default_factory=list)
    unreadable: int = 0


def evaluate_images(
    gaussians: Gaussians,
    recording: Recording,
    posed: PosedFrames,
    *,
    lpips_weights: LpipsWeights | None,
    every: int = 1,
    max_lpips_frames: int = 40,
    progress: Callable[..., object] | None = None,
) -> ImageFigures:
    """Render the map at the estimated poses and compare with the recorded images.

    Args:
        gaussians: the map.
        recording: source of the images.
        posed: the frames to compare, with their poses.
        lpips_weights: weights of LPIPS; None leaves LPIPS out.
        every: n takes the last of every n frames, and half as many of those held out.
        max_lpips_frames: most frames for LPIPS, evenly spaced.
        progress: called as `progress(done)` with the number of frames of the recording gone through.
    """
    members = _scored(len(recording), posed, every)
    chosen = np.flatnonzero(np.any(list(members.values()), axis=0)).tolist()
    used = np.isin(np.arange(len(recording)), posed.keyframes)
    perceptual = _evenly(members[LPIPS_PROTOCOL], max_lpips_frames)
    places = {number: place for place, number in enumerate(posed.indices.tolist())}
    render = MapRenderer(gaussians, recording.camera, posed.background)
    figures = ImageFigures()
    for place, frame in prefetch(Selection(recording, chosen, max_depth=None)):
        index = chosen[place]
        if isinstance(frame, FrameError):
            figures.unreadable += 1
        else:
            at = places[index]
            output = render(posed.poses[at], posed.shutter(at))
            image, recorded = posed.shown(at, output.rgb), (frame.rgb, frame.depth, frame.mask)
            own: list[Protocol] = [name for name in PROTOCOLS if members[name][index]]
            psnrs = psnr_by_protocol(image, *recorded, output.rgb)
            ssims = ssim_by_protocol(image, *recorded, output.rgb)
            depth_l1, coverage = _geometry(output, frame.depth, frame.mask)
            distance = None
            if lpips_weights is not None and perceptual[index]:
                distance = float(_masked_lpips(lpips_weights, image, *recorded))
            figures.frames.append(
                FrameFigures(
                    index=index,
                    timestamp=float(recording.timestamps[index]),
                    view=bool(used[index]),
                    psnr={name: float(psnrs[name]) for name in own},
                    ssim={name: float(ssims[name]) for name in own},
                    depth_l1_m=float(depth_l1),
                    coverage=float(coverage),
                    lpips=distance,
                )
            )
        if progress is not None:
            progress(index + 1)
    if progress is not None and (not chosen or chosen[-1] + 1 < len(recording)):
        progress(len(recording))
    return figures


def _scored(num_frames: int, posed: PosedFrames, every: int) -> dict[Protocol, Bool[np.ndarray, " n"]]:
    """The frames that each protocol scores; `every` as in `evaluate_images`."""
    number = np.arange(num_frames)
    known, sampled = np.isin(number, posed.indices), (number + 1) % every == 0
    members: dict[Protocol, Bool[np.ndarray, " n"]] = {}
    for name in PROTOCOLS:
        frames = known & frames_of(name, num_frames, posed.keyframes)
        members[name] = frames & (sampled | (name == "held_out"))
    if every > 1:
        members["held_out"] = _evenly(members["held_out"], max(1, sum(sampled) // 2))
    return members


def _evenly(members: Bool[np.ndarray, " n"], at_most: int) -> Bool[np.ndarray, " n"]:
    """At most `at_most` of the members, evenly spaced."""
    indices = np.flatnonzero(members)
    places = np.linspace(0, len(indices) - 1, min(at_most, len(indices))).round().astype(int)
    spread = np.zeros_like(members)
    spread[indices[places]] = True
    return spread


@jax.jit
def _geometry(
    output: RenderOutput, depth: Float[Array, "H W"], valid: Bool[Array, "H W"]
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Mean distance from the recorded depth where the map is opaque, NaN if nowhere; mean opacity."""
    both = valid & (depth > 0) & (output.alpha > OPAQUE)
    return (
        jnp.mean(jnp.abs(output.depth - depth), where=both),
        jnp.mean(output.alpha, where=valid),
    )


@jax.jit
def _masked_lpips(
    weights: LpipsWeights,
    image: Float[Array, "H W 3"],
    rgb: Float[Array, "H W 3"],
    depth: Float[Array, "H W"],
    valid: Bool[Array, "H W"],
) -> Float[Array, ""]:
    masked_image, masked_rgb = masked_images(image.clip(0, 1), rgb, valid & (depth > 0))
    return lpips(weights, masked_image, masked_rgb)
