"""Frames of a recording at a small size with their true poses: synthetic places, and real recordings."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from experiments.recordings import SOURCES
from sfgs_jax import datasets
from sfgs_jax.geometry import Camera, downscale_depth, downscale_rgb

FRAMES = {"room": 120, "ring": 1000, "twins": 600, "wall": 300, "sphere": 400, "building": 1800}
"""Frames with which each synthetic place is walked through at the pace of a hand-held camera."""
WIDTH = 160
LATE = 0.02
"""Largest time between a frame and its true pose, seconds."""


class TrueClip(NamedTuple):
    """Frames in order of time.

    Attributes:
        camera: their intrinsics.
        rgb, depth: (N, H, W, 3) in [0, 1] and (N, H, W) in metres.
        elapsed: (N,) seconds since the frame before; 0 for the first.
        poses: (N, 4, 4) true `T_world_cam`.
    """

    camera: Camera
    rgb: Float[np.ndarray, "n H W 3"]
    depth: Float[np.ndarray, "n H W"]
    elapsed: Float[np.ndarray, " n"]
    poses: Float[np.ndarray, "n 4 4"]


def opened(name: str, seed: int = 0, width: int = WIDTH, *, faults: bool = False) -> datasets.Recording:
    """A synthetic place with the noise of a Kinect, or a real recording.

    Args:
        name: of a place in `FRAMES` or of a recording in `SOURCES`.
        seed: of a place.
        width: columns of a place's images.
        faults: whether a place's camera has the systematic faults of a Kinect too.
    """
    if name in FRAMES:
        return datasets.SyntheticRecording(
            num_frames=FRAMES[name],
            width=width,
            height=width * 3 // 4,
            seed=seed,
            noise=True,
            place=name,
            faults=datasets.KINECT_V1 if faults else None,
        )
    return datasets.open_recording(SOURCES[name])


def with_truth(recording: datasets.Recording) -> np.ndarray:
    """Numbers of the frames whose true pose is known."""
    truth = recording.ground_truth
    assert truth is not None
    return datasets.poses_at(truth, recording.timestamps, LATE)[1]


def true_clip(
    recording: datasets.Recording, numbers: Sequence[int] | np.ndarray, width: int = WIDTH
) -> TrueClip:
    """Frames of a recording, reduced to a width.

    Args:
        recording: its width is a multiple of `width`.
        numbers: of the frames, all with a true pose.
        width: columns.
    """
    truth, factor = recording.ground_truth, recording.camera.width // width
    assert truth is not None
    frames = [recording[int(i)] for i in numbers]
    times = np.asarray([f.timestamp for f in frames])
    rgb, depth = [f.rgb for f in frames], [f.depth for f in frames]
    camera = recording.camera
    if factor > 1:
        camera = camera.downscaled(factor)
        rgb = [np.asarray(downscale_rgb(jnp.asarray(x), factor)) for x in rgb]
        depth = [np.asarray(downscale_depth(jnp.asarray(x), factor)) for x in depth]
    poses = datasets.poses_at(truth, times, LATE)[0].poses
    elapsed = np.diff(times, prepend=times[:1]).astype(np.float32)
    return TrueClip(camera, np.stack(rgb), np.stack(depth), elapsed, poses)
