"""Perturbations of one image applied to every frame of a recording, with one severity or a new one each."""

from dataclasses import replace

import numpy as np

from experiments.perturbations.colour import ImageChange
from experiments.perturbations.recording import Perturbed, Severity, at, generator, whole
from sfgs_jax.datasets import Recording
from sfgs_jax.geometry import Frame


def with_colour(recording: Recording, kind: ImageChange, severity: Severity, seed: int) -> Perturbed:
    """The recording with changed colour images, cut to [0, 1].

    Args:
        recording: any.
        kind: of the change.
        severity: 1 to 5, or "dynamic".
        seed: of the random numbers.
    """

    def change(frame: Frame, number: int) -> Frame:
        random = generator(seed, number)
        parameter = _parameter(kind, severity, random)
        image = kind.apply(np.asarray(frame.rgb, np.float32), random, parameter)
        return replace(frame, rgb=np.clip(image, 0, 1).astype(np.float32))

    return replace(whole(recording), change=change)


def with_depth(recording: Recording, kind: ImageChange, severity: Severity, seed: int) -> Perturbed:
    """The recording with changed depth images; arguments as of `with_colour`."""

    def change(frame: Frame, number: int) -> Frame:
        random = generator(seed, number)
        parameter = _parameter(kind, severity, random)
        image = kind.apply(np.asarray(frame.depth, np.float32), random, parameter)
        return replace(frame, depth=image.astype(np.float32))

    return replace(whole(recording), change=change)


def _parameter(kind: ImageChange, severity: Severity, random: np.random.Generator) -> object:
    """The parameter of a severity, which is drawn for each frame if it is "dynamic"."""
    return at(kind.parameters, int(random.integers(1, 6)) if severity == "dynamic" else severity)
