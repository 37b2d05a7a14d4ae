"""All settings of a run."""

from dataclasses import dataclass, field

from sfgs_jax.arrays import InputError, check_counts, check_range
from sfgs_jax.slam.config._graph import GraphConfig
from sfgs_jax.slam.config._mapping import MappingConfig
from sfgs_jax.slam.config._tracking import TrackingConfig


@dataclass(frozen=True)
class SlamConfig:
    """Settings of a run; hashable, so that they can be a static argument of compiled functions."""

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    """Pose of a frame."""
    graph: GraphConfig = field(default_factory=GraphConfig)
    """Graph of keyframes."""
    mapping: MappingConfig = field(default_factory=MappingConfig)
    """Gaussian map."""
    seed: int = 0
    """Seed of the random choice of views."""
    max_skipped_fraction: float = 0.1
    """Share of frames that may fail to decode before the run stops; the first four failures never stop it."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_counts(self, 0, "seed")
        check_range(self, 0, 1, "max_skipped_fraction")
        if self.tracking.features.kind == "none" and not self.tracking.use_surface:
            raise InputError("Without keypoints and without GICP nothing is left to track with.")
