"""Is there depth on most pixels, in fine steps?"""

import numpy as np

from sfgs_jax.evaluation.recording_check._finding import Finding
from sfgs_jax.evaluation.recording_check._sample import RecordingSample

_LEAST_COVERAGE = 0.25
_FEWEST_VALUES = 100
"""Different depths in a whole recording: an image of 8 bits has 256, of which few are in use."""


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
    values = len(np.unique(sample.depths))
    evidence["different depths"] = values
    if values < _FEWEST_VALUES and len(sample.depths) > 20 * _FEWEST_VALUES:
        return Finding(
            "depth coverage",
            "warning",
            f"Depth has only {values} different values in all frames; a sensor gives hundreds.",
            "Save the sensor's 16-bit depth, not a picture of it with 8 bits.",
            evidence,
        )
    return Finding("depth coverage", "good", text + ".", evidence=evidence)
