"""A handful of rendered views beside the recorded ones."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation.image_metrics import psnr
from sfgs_jax.evaluation.map_renderer import MapRenderer
from sfgs_jax.evaluation.run_folder import PosedFrames
from sfgs_jax.geometry import FrameError
from sfgs_jax.splatting import Gaussians


@dataclass(frozen=True)
class View:
    """One frame and the map seen from its estimated pose.

    Attributes:
        index: position in the recording.
        time_s: seconds since the recording's first frame.
        keyframe: whether it was used for mapping.
        rgb: (H, W, 3) recorded image in [0, 1].
        depth: (H, W) recorded depth, metres, 0 where missing.
        rendered_rgb: (H, W, 3) in [0, 1].
        rendered_depth: (H, W) metres, 0 where the map is mostly transparent.
        psnr: dB, of every pixel.
    """

    index: int
    time_s: float
    keyframe: bool
    rgb: np.ndarray
    depth: np.ndarray
    rendered_rgb: np.ndarray
    rendered_depth: np.ndarray
    psnr: float


def render_views(gaussians: Gaussians, recording: Recording, posed: PosedFrames, count: int) -> list[View]:
    """At most `count` views, evenly spaced over the posed frames; unreadable frames are left out."""
    render = MapRenderer(gaussians, recording.camera)
    last = len(posed.indices) - 1
    views = []
    for place in np.unique(np.linspace(0, last, min(count, last + 1)).round().astype(int)).tolist():
        index = int(posed.indices[place])
        try:
            frame = recording[index]
        except FrameError:
            continue
        output = jax.device_get(render(posed.poses[place]))
        rendered = np.clip(output.rgb, 0, 1)
        views.append(
            View(
                index=index,
                time_s=float(recording.timestamps[index] - recording.timestamps[0]),
                keyframe=bool(np.isin(index, posed.keyframes)),
                rgb=np.asarray(frame.rgb),
                depth=np.asarray(frame.depth),
                rendered_rgb=rendered,
                rendered_depth=np.where(output.alpha > 0.5, output.depth, 0),
                psnr=float(psnr(jnp.asarray(rendered), jnp.asarray(frame.rgb))),
            )
        )
    return views
