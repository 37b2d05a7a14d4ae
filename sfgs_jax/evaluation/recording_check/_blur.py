"""Are the images sharp?

Source: Crete, Dolmiere, Ladret and Nicolas, The blur effect: perception and estimation with a new
no-reference perceptual blur metric, 2007.
"""

import cv2
import numpy as np
from jaxtyping import UInt8

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_BLURRED = 0.62
"""Blur effect beyond which an image counts as blurred."""
_MOST_BLURRED = 0.5


def blur_effect(grey: UInt8[np.ndarray, "h w"]) -> float:
    """Share of the differences between neighbours that one more blur leaves: 0 sharp, 1 blurred.

    The larger of the shares along rows and along columns, as motion blurs one direction.

    Args:
        grey: brightness.
    """
    image = grey.astype(np.float32)
    shares = []
    for axis, size in ((0, (1, 9)), (1, (9, 1))):
        blurred = cv2.blur(image, size)
        sharp = np.abs(np.diff(image, axis=axis))
        lost = np.maximum(0, sharp - np.abs(np.diff(blurred, axis=axis)))
        total = float(sharp.sum())
        shares.append((total - float(lost.sum())) / total if total > 0 else 1.0)
    return max(shares)


def check_blur(sample: RecordingSample) -> Finding:
    """Are most of the images sharp?

    Args:
        sample: of the recording.
    """
    effects = np.array([blur_effect(frame.grey) for frame in sample.frames[::2]])
    share, median = float(np.mean(effects > _BLURRED)), float(np.median(effects))
    evidence = {"median blur effect": median, "blurred share": share}
    text = f"Blur {median:.2f} of 1; {100 * share:.0f} % of the images are over {_BLURRED:g}"
    if share <= _MOST_BLURRED:
        return Finding("blur", "good", text + ".", evidence=evidence)
    return Finding(
        "blur",
        "warning",
        f"{text}, under {100 * _MOST_BLURRED:.0f} % is expected.",
        "Move more slowly, expose for a shorter time in more light, and check the focus.",
        evidence,
    )
