"""Image metrics of a map over a whole recording, one frame in memory at a time."""

from collections.abc import Callable
from dataclasses import dataclass, field

import jax
import numpy as np
from jaxtyping import Array, Bool, Float

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording, Selection, prefetch
from sfgs_jax.evaluation._run_folder import PosedFrames
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
from sfgs_jax.splatting import Gaussians

LPIPS_PROTOCOL: Protocol = "splatam"
"""The only protocol of LPIPS, which takes several times as long as the other metrics together."""


@dataclass
class ImageFigures:
    """Figures of every scored frame.

    Attributes:
        psnr: dB, by protocol.
        ssim: by protocol.
        lpips: LPIPS of the frames it was computed for, protocol `LPIPS_PROTOCOL`.
        unreadable: frames with a pose that could not be decoded.
    """

    psnr: dict[Protocol, list[float]] = field(default_factory=lambda: {name: [] for name in PROTOCOLS})
    ssim: dict[Protocol, list[float]] = field(default_factory=lambda: {name: [] for name in PROTOCOLS})
    lpips: list[float] = field(default_factory=list)
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
        every: n takes the last of every n frames.
        max_lpips_frames: most frames for LPIPS, evenly spaced.
        progress: called as `progress(done)` with the number of frames of the recording gone through.
    """
    chosen = range(every - 1, len(recording), every)
    evaluated = np.isin(np.arange(len(recording)), chosen) & np.isin(np.arange(len(recording)), posed.indices)
    members = {name: evaluated & frames_of(name, len(recording), posed.keyframes) for name in PROTOCOLS}
    perceptual = _evenly(members[LPIPS_PROTOCOL], max_lpips_frames)
    places = {number: place for place, number in enumerate(posed.indices.tolist())}
    render = MapRenderer(gaussians, recording.camera)
    figures = ImageFigures()
    for place, frame in prefetch(Selection(recording, chosen, max_depth=None)):
        index = chosen[place]
        if not evaluated[index]:
            pass
        elif isinstance(frame, FrameError):
            figures.unreadable += 1
        else:
            at = places[index]
            image = render(posed.poses[at], posed.shutter(at)).rgb
            recorded = (frame.rgb, frame.depth, frame.mask)
            own: list[Protocol] = [name for name in PROTOCOLS if members[name][index]]
            _append(figures.psnr, own, _psnr_by_protocol(image, *recorded))
            _append(figures.ssim, own, _ssim_by_protocol(image, *recorded))
            if lpips_weights is not None and perceptual[index]:
                distance = _masked_lpips(lpips_weights, image, *recorded)
                figures.lpips.append(float(distance))
        if progress is not None:
            progress(index + 1)
    return figures


def _evenly(members: Bool[np.ndarray, " n"], at_most: int) -> Bool[np.ndarray, " n"]:
    """At most `at_most` of the members, evenly spaced."""
    indices = np.flatnonzero(members)
    places = np.linspace(0, len(indices) - 1, min(at_most, len(indices))).round().astype(int)
    spread = np.zeros_like(members)
    spread[indices[places]] = True
    return spread


def _append(
    figures: dict[Protocol, list[float]], names: list[Protocol], values: dict[Protocol, Float[Array, ""]]
) -> None:
    for name in names:
        figures[name].append(float(values[name]))


_psnr_by_protocol = jax.jit(psnr_by_protocol)
_ssim_by_protocol = jax.jit(ssim_by_protocol)


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
