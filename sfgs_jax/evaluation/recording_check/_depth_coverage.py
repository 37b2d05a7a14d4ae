"""Is there depth on most pixels, in fine steps?"""

import numpy as np
from jaxtyping import Float

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_LEAST_COVERAGE = 0.25
_VALUES_OF_8_BITS = 256
_ENOUGH = 2000
"""Depths from which the number of different ones can be told."""
_EVEN_SHARE = 0.5
"""Share of steps of one size that makes a scale even."""
_COARSE = 0.005
"""Step as a share of the median depth. Sensors with even steps have millimetres, and begin at 0.2 m."""


def check_coverage(sample: RecordingSample) -> Finding:
    """Is there depth on enough of each image?

    Args:
        sample: of the recording.
    """
    coverage = np.array([frame.coverage for frame in sample.frames])
    median, empty = float(np.median(coverage)), float(np.mean(coverage < 0.02))
    evidence = {"median coverage": median, "share of frames without depth": empty}
    text = f"{100 * median:.0f} % of the pixels have depth"
    if median < _LEAST_COVERAGE or empty > 0.2:
        return Finding(
            "depth coverage",
            "warning",
            f"{text}, and {100 * empty:.0f} % of the frames have none; at least "
            f"{100 * _LEAST_COVERAGE:.0f} % is expected.",
            "Stay within the sensor's range, avoid glass and sunlight, and check --reader.max-depth and "
            "--reader.min-confidence.",
            evidence,
        )
    values = np.unique(sample.depths.astype(np.float64))
    evidence["different depths"] = len(values)
    if _is_picture(values, sample.depths):
        return Finding(
            "depth coverage",
            "warning",
            f"Depth has only {len(values)} different values, in even steps; a sensor gives hundreds.",
            "Save the sensor's 16-bit depth, not a picture of it with 8 bits.",
            evidence,
        )
    return Finding("depth coverage", "good", text + ".", evidence=evidence)


def _is_picture(values: Float[np.ndarray, " k"], depths: Float[np.ndarray, " n"]) -> bool:
    """Whether depth was stored in 8 bits: few values, and coarse steps of one size.

    A bare wall has few depths as well. But the steps of structured light grow with the square of depth, and
    those of other sensors are millimetres.
    """
    if len(depths) < _ENOUGH or not 2 < len(values) <= _VALUES_OF_8_BITS:
        return False
    steps = np.diff(values)
    usual = float(np.median(steps))
    even = float(np.mean(np.abs(steps - usual) < 0.1 * usual))
    return even > _EVEN_SHARE and usual > _COARSE * float(np.median(depths))
