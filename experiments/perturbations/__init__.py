"""Perturbations of recordings by name: each makes a recording of another one, by severity and seed."""

from collections.abc import Callable
from typing import NamedTuple

from experiments.perturbations import calibration, light, stream
from experiments.perturbations.colour import COLOUR, ImageChange
from experiments.perturbations.depth import DEPTH
from experiments.perturbations.images import with_colour, with_depth
from experiments.perturbations.recording import Perturbed, Severity, whole
from sfgs_jax.datasets import Recording

STATIC: tuple[Severity, ...] = (1, 3, 5)
DYNAMIC: tuple[Severity, ...] = (*STATIC, "dynamic")


class Perturbation(NamedTuple):
    """A perturbation of recordings.

    Attributes:
        apply: from a recording, a severity and a seed to another recording.
        severities: those of the benchmark.
    """

    apply: Callable[[Recording, Severity, int], Perturbed]
    severities: tuple[Severity, ...]


def _on_images(
    apply: Callable[[Recording, ImageChange, Severity, int], Perturbed], kind: ImageChange
) -> Perturbation:
    def perturb(recording: Recording, severity: Severity, seed: int) -> Perturbed:
        return apply(recording, kind, severity, seed)

    return Perturbation(perturb, DYNAMIC)


def _none(recording: Recording, severity: Severity, seed: int) -> Perturbed:
    return whole(recording)


PERTURBATIONS = {
    "none": Perturbation(_none, (1,)),
    **{name: _on_images(with_colour, kind) for name, kind in COLOUR.items()},
    "exposure": Perturbation(light.exposure, STATIC),
    **{name: _on_images(with_depth, kind) for name, kind in DEPTH.items()},
    "without depth": Perturbation(stream.without_depth, STATIC),
    "every k-th frame": Perturbation(stream.every_kth, STATIC),
    "dropped frames": Perturbation(stream.dropped, STATIC),
    "duplicated frames": Perturbation(stream.duplicated, STATIC),
    "frozen frames": Perturbation(stream.frozen, STATIC),
    "black frames": Perturbation(stream.black, STATIC),
    "black, no depth": Perturbation(stream.blind, STATIC),
    "out of order": Perturbation(stream.out_of_order, STATIC),
    "gap": Perturbation(stream.gap, STATIC),
    "kidnapped": Perturbation(stream.kidnapped, STATIC),
    "late depth": Perturbation(calibration.late_depth, DYNAMIC),
    "wrong intrinsics": Perturbation(calibration.wrong_intrinsics, STATIC),
    "wrong depth scale": Perturbation(calibration.wrong_scale, STATIC),
    "change of depth scale": Perturbation(calibration.scale_change, STATIC),
}
"""All perturbations by name; "none" is the recording as it was."""
