"""Settings of the SLAM system: frozen dataclasses, so that a configuration can be a static argument."""

from dataclasses import dataclass, field

from sfgs_jax.gicp import GicpConfig


@dataclass(frozen=True)
class TrackingConfig:
    """How a frame's pose is found: GICP against the reference keyframe."""

    gicp: GicpConfig = field(default_factory=GicpConfig)
    """Registration settings."""
    min_inlier_fraction: float = 0.3
    """A frame whose share of matched points is below this, from every start, is lost."""
    num_references: int = 12
    """Reference keyframes that are kept; a new one is registered to all that it overlaps."""
    max_correction: float = 0.1
    """A registration to an older reference that disagrees by more than this, metres, is not believed."""
    keyframe_inlier_fraction: float = 0.6
    """A new reference keyframe is taken when the share of matched points falls below this."""
    keyframe_translation: float = 0.3
    """... or when the camera moved this far from the reference, metres."""
    keyframe_rotation: float = 0.35
    """... or when it turned this far, radians."""


@dataclass(frozen=True)
class LearningRates:
    """Adam's step size for each parameter of the Gaussians."""

    means: float = 2e-4
    """Metres."""
    quaternions: float = 2e-3
    """Of the unnormalised quaternion."""
    log_scales: float = 5e-3
    """Of the logarithm of the scale."""
    opacity_logits: float = 2e-2
    """Of the opacity before the sigmoid."""
    sh: float = 5e-3
    """Of the spherical-harmonics coefficients."""


@dataclass(frozen=True)
class SeedingConfig:
    """Where new Gaussians are set, and how they start."""

    stride: int = 2
    """New Gaussians are set on every stride-th pixel of the reduced image."""
    min_alpha: float = 0.6
    """A pixel with less accumulated opacity than this needs a Gaussian."""
    depth_margin: float = 0.05
    """... and so does one whose surface lies this share of its depth in front of the map's."""
    opacity: float = 0.7
    """Opacity of a new Gaussian."""
    scale: float = 0.6
    """Standard deviation of a new Gaussian along the surface, in spacings of the seeds."""
    thickness: float = 0.3
    """Standard deviation across the surface, as a share of that along it."""
    max_depth: float = 12.0
    """Surfaces farther away than this, metres, get no Gaussians."""


@dataclass(frozen=True)
class OptimisationConfig:
    """What an optimisation step minimises, and how far it goes."""

    ssim_weight: float = 0.2
    """Weight of 1 - SSIM against L1 in the colour loss."""
    depth_weight: float = 0.1
    """Weight of the depth loss (L1, metres)."""
    learning_rates: LearningRates = field(default_factory=LearningRates)
    """Adam's step sizes."""


@dataclass(frozen=True)
class MappingConfig:
    """How the map is grown and optimised."""

    max_width: int = 320
    """Mapping works on images reduced by the smallest whole factor that brings them to this width."""
    capacity: int = 131_072
    """Gaussians the map has room for at first; it doubles when full."""
    max_capacity: int = 1_048_576
    """The map never grows beyond this; what did not fit is reported."""
    pair_capacity: int = 131_072
    """(tile, Gaussian) pairs a rendering has room for at first; it grows when a view needs more."""
    keyframe_interval: int = 8
    """A mapping keyframe is taken this many frames after the last one, if not sooner for tracking."""
    keyframe_capacity: int = 256
    """Mapping keyframes whose images are kept; beyond it the oldest is dropped."""
    steps_per_frame: int = 1
    """Optimisation steps after each tracked frame."""
    steps_per_keyframe: int = 4
    """Further optimisation steps on a new keyframe."""
    final_steps: int = 200
    """Optimisation steps over all keyframes after the last frame."""
    newest_share: float = 0.3
    """Share of steps spent on the newest keyframe; the others are drawn uniformly."""
    prune_interval: int = 200
    """Steps between two removals of transparent Gaussians."""
    prune_opacity: float = 0.02
    """Gaussians below this opacity are removed."""
    seeding: SeedingConfig = field(default_factory=SeedingConfig)
    """New Gaussians."""
    optimisation: OptimisationConfig = field(default_factory=OptimisationConfig)
    """Loss and step sizes."""


@dataclass(frozen=True)
class SlamConfig:
    """All settings of a run."""

    tracking: TrackingConfig = field(default_factory=TrackingConfig)
    """Pose estimation."""
    mapping: MappingConfig = field(default_factory=MappingConfig)
    """The Gaussian map."""
    seed: int = 0
    """Seed of the choice of keyframes to optimise."""
    max_skipped_fraction: float = 0.1
    """The run stops when more than this share of the frames could not be decoded (and at least 5)."""
