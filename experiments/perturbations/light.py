"""Light that changes in steps, followed by an automatic exposure with a lag."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from experiments.perturbations.recording import Perturbed, Severity, at, whole
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Frame

STOPS = (0.5, 1.0, 1.5, 2.0, 2.5)
"""Step of the light for severities 1 to 5, in powers of two."""
_PERIOD, _LAG = 30, 10
"""Frames between two steps, and frames in which the exposure makes up for all but 1/e of one."""


def gains(num_frames: int, stops: float) -> Float[np.ndarray, " n"]:
    """Factor on each frame's colour: light up and down by `stops`, divided by what the exposure expects.

    Args:
        num_frames: number of frames.
        stops: step of the light, in powers of two.
    """
    light = stops * (np.arange(num_frames) // _PERIOD % 2)
    expected, found = 0.0, []
    for value in light:
        found.append(value - expected)
        expected += (value - expected) * (1 - np.exp(-1 / _LAG))
    return 2.0 ** np.asarray(found)


def exposure(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    """The recording in light that changes every second."""
    factors = gains(len(recording), at(STOPS, severity))

    def change(frame: Frame, number: int) -> Frame:
        rgb = np.clip(np.asarray(frame.rgb) * factors[number], 0, 1)
        return replace(frame, rgb=rgb.astype(np.float32))

    return replace(whole(recording), change=change)
