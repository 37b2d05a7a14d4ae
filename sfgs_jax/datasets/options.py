"""What a user may choose about how a recording is read."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class ReaderOptions:
    """How a recording is read; the defaults are right for the published data sets."""

    association_limit: float = 0.02
    """Largest difference of two time stamps, seconds, for colour, depth and pose to belong together (TUM)."""
    depth_scale: float | None = None
    """Depth image units per metre; None takes the layout's own (TUM 5000, 7-Scenes 1000, ...)."""
    camera: Path | None = None
    """A camera.json (see docs/datasets.md) to use instead of the layout's intrinsics."""
    max_depth: float | None = None
    """Depth beyond this many metres counts as missing; None keeps everything."""
    start: int = 0
    """First frame, counted from 0."""
    end: int | None = None
    """Frame before which to stop; None reads to the end."""
    stride: int = 1
    """Take every stride-th frame."""
