"""Rendered views beside the recorded ones."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.images import MapRenderer, psnr
from sfgs_jax.splatting import Gaussians

# A pixel whose accumulated opacity is below this shows too little of the map for a depth.
_OPAQUE = 0.5


@dataclass(frozen=True)
class ComparedView:
    """One frame and the map seen from its estimated pose.

    Attributes:
        index: position in the recording.
        time_s: seconds since the recording's first frame.
        keyframe: True if the frame was used for mapping.
        rgb: recorded image in [0, 1].
        depth: recorded depth, metres, 0 where missing.
        rendered_rgb: rendered image in [0, 1].
        rendered_depth: metres, 0 where the map is mostly transparent.
        psnr: dB, of every pixel.
    """

    index: int
    time_s: float
    keyframe: bool
    rgb: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    rendered_rgb: Float[np.ndarray, "h w 3"]
    rendered_depth: Float[np.ndarray, "h w"]
    psnr: float


def compared_views(
    gaussians: Gaussians, recording: Recording, posed: PosedFrames, count: int
) -> list[ComparedView]:
    """Views evenly spaced over the posed frames; unreadable frames are left out.

    Args:
        gaussians: the map.
        recording: source of the images.
        posed: the frames to choose from, with their poses.
        count: most views.
    """
    render = MapRenderer(gaussians, recording.camera)
    last = len(posed.indices) - 1
    views = []
    for place in np.unique(np.linspace(0, last, min(count, last + 1)).round().astype(int)).tolist():
        index = int(posed.indices[place])
        try:
            frame = recording[index]
        except FrameError:
            continue
        output = jax.device_get(render(posed.poses[place], posed.shutter(place)))
        rendered = np.clip(output.rgb, 0, 1)
        views.append(
            ComparedView(
                index=index,
                time_s=float(recording.timestamps[index] - recording.timestamps[0]),
                keyframe=bool(np.isin(index, posed.keyframes)),
                rgb=np.asarray(frame.rgb),
                depth=np.asarray(frame.depth),
                rendered_rgb=rendered,
                rendered_depth=np.where(output.alpha > _OPAQUE, output.depth, 0),
                psnr=float(psnr(jnp.asarray(rendered), jnp.asarray(frame.rgb))),
            )
        )
    return views
