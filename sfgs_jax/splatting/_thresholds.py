"""Thresholds that the steps of the renderer share."""

LOW_PASS = 0.3
"""Variance added to both axes of every image, pixels²: no Gaussian falls between pixels."""

MIN_ALPHA = 1 / 255
"""Contributions below this are skipped."""
