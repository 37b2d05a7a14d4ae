"""Wrong knowledge of the camera: focal length, scale of depth, and the time between colour and depth."""

from dataclasses import replace

import numpy as np

from experiments.perturbations.recording import Perturbed, Severity, at, generator, whole
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Camera, Frame

ERRORS = (0.01, 0.02, 0.03, 0.04, 0.05)
"""Relative errors of a focal length or scale."""
DELAYS = (1, 2, 3, 4, 5)
"""Frames that depth is late."""


def wrong_intrinsics(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """The camera is said to have longer focal lengths than it has."""
    camera, factor = recording.camera, 1 + at(ERRORS, severity)
    said = Camera(
        factor * camera.fx,
        factor * camera.fy,
        camera.cx,
        camera.cy,
        width=camera.width,
        height=camera.height,
    )
    return replace(whole(recording), camera=said)


def wrong_scale(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """All depth is too long by a factor."""
    return _scaled(recording, 1 + at(ERRORS, severity), first=0)


def scale_change(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """Depth is too long by a factor from the middle of the recording on."""
    return _scaled(recording, 1 + at(ERRORS, severity), first=len(recording) // 2)


def late_depth(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """Depth comes some frames late, or by a random walk in steps of one if "dynamic"; no stamp tells."""
    numbers = np.arange(len(recording))
    if severity == "dynamic":
        delay = np.cumsum(generator(seed, 0).choice((-1, 1), len(recording)))
    else:
        delay = np.full(len(recording), int(at(DELAYS, severity)))
    return replace(whole(recording), depths=np.clip(numbers - delay, 0, len(recording) - 1))


def _scaled(recording: Recording, factor: float, first: int) -> Perturbed:
    def change(frame: Frame, number: int) -> Frame:
        if number < first:
            return frame
        return replace(frame, depth=np.asarray(frame.depth) * np.float32(factor))

    return replace(whole(recording), change=change)
