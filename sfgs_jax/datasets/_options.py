"""Settings of the readers."""

import math
from dataclasses import dataclass
from pathlib import Path

from sfgs_jax.arrays import InputError, check_counts, check_positive, check_range, excerpt


@dataclass(frozen=True)
class ReaderOptions:
    """Units, intrinsics and choice of frames; the defaults are right for the published data sets."""

    association_limit: float = 0.02
    """Largest difference between the time stamps of a colour image, its depth and its pose (TUM), seconds."""
    depth_scale: float | None = None
    """Depth image units per metre. None takes the layout's own: 5000 for TUM, 1000 for 7-Scenes."""
    camera: Path | None = None
    """A camera.json that replaces the layout's intrinsics; docs/datasets.md explains the file."""
    max_depth: float | None = None
    """Largest depth, metres. Farther depth counts as missing; None keeps everything."""
    min_confidence: int = 1
    """Least confidence of depth to keep, where a phone stores it. 0 keeps all, 1 drops low, 2 keeps high."""
    start: int = 0
    """First frame, counted from 0."""
    end: int | None = None
    """Frame before which to stop. None reads to the end."""
    stride: int = 1
    """Step from one frame to the next. 2 takes every second frame."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        if self.camera is not None and not isinstance(self.camera, Path):
            raise InputError(
                f"The setting camera must be a pathlib.Path or None, not {excerpt(self.camera)}."
            )
        check_range(self, 0, math.inf, "association_limit")
        if self.depth_scale is not None:
            check_range(self, 1e-6, 1e9, "depth_scale")
        if self.max_depth is not None:
            check_positive(self, "max_depth")
        check_counts(self, 1, "stride")
        check_counts(self, 0, "min_confidence", "start")
        if self.end is not None:
            check_counts(self, 0, "end")
