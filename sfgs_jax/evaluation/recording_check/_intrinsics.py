"""Are focal length and principal point those of the images, and is the lens straight?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._frame_pairs import Motion
from sfgs_jax.evaluation.recording_check._lens_fit import fit_lens
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_VIEWS = (15.0, 140.0)
"""Angles of view from side to side, degrees."""
_MOST_OFF_CENTRE = 0.15
"""Of the image's width or height."""
_MOST_UNEQUAL = 1.15
"""Ratio of the focal lengths along rows and columns."""
_FOCAL_TOLERANCE = 0.08
_FOCAL_KNOWN = 0.02
"""Largest standard deviation with which a focal length counts as measured."""
_BEND = 20.0
"""Pixels in an image of 640 that a corner may be moved by the lens."""
_SIGMAS = 5.0
_FEWEST = 6


@dataclass(frozen=True)
class IntrinsicsCheck:
    """What was found about the lens.

    Attributes:
        findings: on intrinsics, and on distortion.
        focal_factor: on the focal lengths, if they are wrong; else 1.
    """

    findings: tuple[Finding, Finding]
    focal_factor: float


def check_intrinsics(
    sample: RecordingSample, motions: Sequence[Motion], *, measured: bool = True
) -> IntrinsicsCheck:
    """Check intrinsics and lens distortion.

    Args:
        sample: of the recording.
        motions: of pairs of frames.
        measured: whether motions are to be believed; if not, only the numbers themselves are looked at.
    """
    camera = sample.recording.camera
    (fx, _, cx), (_, fy, cy), _ = np.asarray(camera.matrix(), float)
    view = float(np.degrees(2 * np.arctan(camera.width / 2 / fx)))
    unequal = max(fx / fy, fy / fx)
    off = max(abs(cx / (camera.width - 1) - 0.5), abs(cy / (camera.height - 1) - 0.5))
    evidence = {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy), "view degrees": view}
    odd, factor = [], 1.0
    if not _VIEWS[0] < view < _VIEWS[1]:
        odd.append(f"the view is {view:.0f} degrees wide, {_VIEWS[0]:.0f} to {_VIEWS[1]:.0f} are expected")
    if unequal > _MOST_UNEQUAL:
        odd.append(f"fx and fy differ by {100 * (unequal - 1):.0f} %, under 15 % is expected")
    if off > _MOST_OFF_CENTRE:
        odd.append(f"the principal point is {100 * off:.0f} % off the centre, under 15 % is expected")
    advice = (
        "Take the intrinsics of the colour camera at this image size; if images were resized, scale all four "
        "numbers alike."
    )
    good = [motion for motion in motions if motion.share > 0.3] if measured else []
    fit = fit_lens(good, sample) if len(good) >= _FEWEST else None
    known = fit is not None and fit.focal_sigma < _FOCAL_KNOWN and 0.3 < fit.focal < 3
    if fit is not None and known:
        evidence |= {"focal factor": fit.focal, "focal sigma": fit.focal_sigma}
        distance = abs(np.log(fit.focal))
        if distance > max(_FOCAL_TOLERANCE, _SIGMAS * fit.focal_sigma):
            odd.append(f"the focal length is {fx:.0f} pixels, but motion asks for {fx * fit.focal:.0f}")
            factor = fit.focal
    if odd:
        message = _sentence(odd)
        first = Finding("intrinsics", "warning", message, advice, evidence)
    elif fit is not None and known:
        message = f"Motion and depth ask for a focal length of {fx * fit.focal:.0f} pixels; it is {fx:.0f}."
        first = Finding("intrinsics", "good", message, evidence=evidence)
    else:
        message = "It can't be told whether the focal length is right: motion does not tell it."
        first = Finding("intrinsics", "unknown", message, evidence=evidence)
    if fit is None or not known:
        message = "It can't be told whether the lens bends the image: motion does not tell it."
        return IntrinsicsCheck((first, Finding("distortion", "unknown", message)), factor)
    bend = _distortion(fit.corner_shift / sample.pixel, fit.radial, fit.radial_sigma)
    return IntrinsicsCheck((first, bend), factor)


def _distortion(corner: float, radial: float, sigma: float) -> Finding:
    evidence = {"k1": radial, "k1 sigma": sigma, "corner px of 640": corner}
    if abs(corner) < _BEND or abs(radial) < _SIGMAS * sigma:
        message = f"The lens moves corners by {abs(corner):.0f} pixels of 640."
        return Finding("distortion", "good", message, evidence=evidence)
    return Finding(
        "distortion",
        "warning",
        f"The lens moves corners by {abs(corner):.0f} pixels of 640, under {_BEND:.0f} are expected.",
        f"Give the lens's coefficients as `distortion` in camera.json; k1 is near {radial:.2f}.",
        evidence,
    )


def _sentence(parts: list[str]) -> str:
    text = "; ".join(parts)
    return text[0].upper() + text[1:] + "."
