"""Rendered views beside the recorded ones."""

from dataclasses import dataclass

import jax
import numpy as np
from jaxtyping import Float

from sfgs_jax.arrays import FrameError
from sfgs_jax.datasets import Recording
from sfgs_jax.evaluation._run_folder import PosedFrames
from sfgs_jax.evaluation.images import OPAQUE, MapRenderer, psnr_by_protocol
from sfgs_jax.splatting import Gaussians


@dataclass(frozen=True)
class ComparedView:
    """One frame and the map seen from its estimated pose.

    Attributes:
        index: position in the recording.
        time_s: seconds since the recording's first frame.
        keyframe: True if the frame was used for mapping.
        worst: True if it is one of the worst.
        rgb: recorded image in [0, 1].
        depth: recorded depth, metres, 0 where missing.
        rendered_rgb: rendered image in [0, 1].
        rendered_depth: metres, 0 where the map is mostly transparent.
        psnr: dB, by the protocol `all`.
    """

    index: int
    time_s: float
    keyframe: bool
    worst: bool
    rgb: Float[np.ndarray, "h w 3"]
    depth: Float[np.ndarray, "h w"]
    rendered_rgb: Float[np.ndarray, "h w 3"]
    rendered_depth: Float[np.ndarray, "h w"]
    psnr: float


def compared_views(
    gaussians: Gaussians, recording: Recording, posed: PosedFrames, count: int, worst: list[int]
) -> list[ComparedView]:
    """Views evenly spaced over the posed frames, and the worst; unreadable frames are left out.

    Args:
        gaussians: the map.
        recording: source of the images.
        posed: the frames to choose from, with their poses.
        count: most views that are evenly spaced.
        worst: positions in the recording of the frames to show besides.
    """
    render = MapRenderer(gaussians, recording.camera, posed.background)
    last = len(posed.indices) - 1
    views = []
    even = np.linspace(0, last, min(count, last + 1)).round().astype(int)
    for place in np.union1d(even, np.flatnonzero(np.isin(posed.indices, worst))).tolist():
        index = int(posed.indices[place])
        try:
            frame = recording[index]
        except FrameError:
            continue
        output = render(posed.poses[place], posed.shutter(place))
        rendered = np.clip(jax.device_get(posed.shown(place, output.rgb)), 0, 1)
        output = jax.device_get(output)
        views.append(
            ComparedView(
                index=index,
                time_s=float(recording.timestamps[index] - recording.timestamps[0]),
                keyframe=bool(np.isin(index, posed.keyframes)),
                worst=index in worst,
                rgb=np.asarray(frame.rgb),
                depth=np.asarray(frame.depth),
                rendered_rgb=rendered,
                rendered_depth=np.where(output.alpha > OPAQUE, output.depth, 0),
                psnr=float(psnr_by_protocol(rendered, frame.rgb, frame.depth, frame.mask)["all"]),
            )
        )
    return views
