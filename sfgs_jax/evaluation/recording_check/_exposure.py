"""Are the images bright enough, and of one brightness?"""

import itertools

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_MOST_SATURATED, _MOST_BLACK = 0.3, 0.5
"""Shares of the pixels."""
_DARK, _BRIGHT = 25, 235
"""Medians of 255 beyond which an image counts as dark or bright."""
_LARGEST_CHANGE = 1.25
"""Ratio of the brightness of a frame and the next."""


def check_exposure(sample: RecordingSample) -> Finding:
    """Are the images neither dark nor saturated, and does their brightness not jump?

    Args:
        sample: of the recording.
    """
    pixels = [frame.grey if frame.seen is None else frame.grey[frame.seen] for frame in sample.frames]
    medians = np.array([float(np.median(values)) for values in pixels])
    saturated = np.array([float(np.mean(values >= 250)) for values in pixels])
    black = np.array([float(np.mean(values <= 5)) for values in pixels])
    too_dark = float(np.mean((medians < _DARK) | (black > _MOST_BLACK)))
    too_bright = float(np.mean((medians > _BRIGHT) | (saturated > _MOST_SATURATED)))
    jumps = float(np.mean(_changes(sample) > _LARGEST_CHANGE)) if len(sample.frames) > 1 else 0.0
    evidence = {
        "median brightness": float(np.median(medians)) / 255,
        "dark share": too_dark,
        "saturated share": too_bright,
        "jumps of brightness share": jumps,
    }
    for share, what, advice in (
        (
            too_dark,
            "are almost black",
            "Add light, or expose longer and move more slowly.",
        ),
        (too_bright, "are saturated in large parts", "Expose less, or lock the exposure on the room."),
    ):
        if share > 0.25:
            message = f"{100 * share:.0f} % of the images {what}; under {25} % is expected."
            return Finding("exposure", "warning", message, advice, evidence)
    if jumps > 0.2:
        return Finding(
            "exposure",
            "warning",
            f"Brightness jumps by more than {100 * (_LARGEST_CHANGE - 1):.0f} % after {100 * jumps:.0f} % of "
            "the frames; under 20 % is expected.",
            "Lock exposure and gain while recording, and avoid lamps that flicker.",
            evidence,
        )
    message = f"Median brightness {evidence['median brightness']:.2f} of 1."
    return Finding("exposure", "good", message, evidence=evidence)


def _changes(sample: RecordingSample) -> np.ndarray:
    """Ratios, at least 1, of the median brightness of frames that follow each other."""
    ratios = [
        (np.median(after.grey) + 4.0) / (np.median(before.grey) + 4.0)
        for window in sample.windows
        for before, after in itertools.pairwise(window)
    ]
    return np.maximum(ratios, 1 / np.asarray(ratios))
