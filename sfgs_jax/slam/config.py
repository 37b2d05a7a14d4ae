"""Settings of the SLAM system: frozen dataclasses, so that a configuration can be a static argument."""

from dataclasses import dataclass, field
from typing import Literal

from sfgs_jax.gicp import GicpConfig
from sfgs_jax.superfeats import MIN_SIMILARITY


@dataclass(frozen=True)
class FeaturesConfig:
    """Keypoints, their matches, and the motion that these give."""

    kind: Literal["superfeats", "orb", "none"] = "superfeats"
    """Which keypoints; `none` leaves tracking to GICP alone."""
    max_keypoints: int = 1024
    """Slots for the keypoints of a frame."""
    min_similarity: float = MIN_SIMILARITY
    """Cosine that the descriptors of a match must exceed."""
    min_contrast: float = 0.015
    """A keypoint counts where the grey values around it bend by at least this, of 1: on a wall without
    texture, or in the dark, an extractor finds its own artefacts. Even shading does not bend."""
    depth_tolerance: float = 0.03
    """A keypoint has no depth if the surface around it bends by more than this share of its depth."""
    max_rigid_matches: int = 256
    """The best matches, from which the first, rigid motion is found."""
    max_distance: float = 0.08
    """A match belongs to the rigid motion if that brings its points closer than this, metres."""
    pixel_sigma: float = 1.0
    """Standard deviation of a keypoint's position, pixels."""
    inverse_depth_sigma: float = 0.003
    """Standard deviation of a keypoint's inverse depth, 1 / m."""
    kernel_width: float = 3.0
    """Width of the Geman-McClure kernel of a match, standard deviations."""
    inlier_pixels: float = 3.0
    """A match is an inlier if its reprojection error is below this, pixels."""
    inlier_depth_sigmas: float = 6.0
    """... and its inverse depth is off by fewer standard deviations than this."""
    correlation: float = 4.0
    """How many matches share one error: those of keypoints close to each other are off together."""
    min_inliers: int = 10
    """With fewer inliers than this the keypoints give no motion."""
    min_inliers_alone: int = 20
    """... and with fewer than this none that stands without the surface, or against it."""
    min_inlier_share: float = 0.25
    """... and neither with a smaller share of all matches."""
    min_inlier_share_alone: float = 0.33
    """... and where the surface leaves a direction free, in which they decide alone, than this."""


@dataclass(frozen=True)
class TrackingConfig:
    """How a frame's pose is found: keypoints and GICP against the reference keyframe."""

    features: FeaturesConfig = field(default_factory=FeaturesConfig)
    """Keypoints."""
    gicp: GicpConfig = field(default_factory=lambda: GicpConfig(strides=(3, 2, 1, 1)))
    """Registration settings. Every third row and column is as good as every second here, and sooner done."""
    use_surface: bool = True
    """Whether GICP takes part; without it keypoints alone carry the poses."""
    guess_sigma: float = 0.1
    """Standard deviation of the motion model's guess, metres and radians."""
    min_inlier_fraction: float = 0.3
    """GICP has failed where the share of matched points is below this."""
    min_inlier_fraction_alone: float = 0.4
    """... and, where no keypoints bear it out, below this share: surfaces fit in many places."""
    min_agreement_alone: float = 0.75
    """... or below this share of the points that the reference has a surface for."""
    max_correction_alone: float = 0.3
    """... or where it then ends farther from where it started, metres or radians."""
    search_angle: float = 0.2
    """How far a lost frame's guesses are turned up, down and sideways, radians: GICP ends where it should
    from starts that are off by about this."""
    max_disagreement: float = 0.1
    """GICP has failed where keypoints give a motion that differs by more, metres or radians."""
    max_coasting: int = 15
    """Frames in a row that may rest on the motion model in a direction that the surface leaves free."""
    max_coasted: float = 0.1
    """... and how far that model may carry them before the next is lost, metres or radians."""
    max_lost: int = 30
    """Lost frames in a row after which the surface alone finds nothing again: surfaces fit in many places,
    and by then the camera may be anywhere. Without keypoints there is nothing else to go by, and no limit."""
    keyframe_inlier_fraction: float = 0.6
    """A new keyframe is taken when the share of matched points falls below this."""
    keyframe_translation: float = 0.3
    """... or when the camera moved this far from the reference, metres."""
    keyframe_rotation: float = 0.35
    """... or when it turned this far, radians."""


@dataclass(frozen=True)
class GraphConfig:
    """The graph of keyframes: which registrations it holds, its window of landmarks, and its loops."""

    enabled: bool = True
    """Without the graph a keyframe stays where it was first tracked, and no loop is closed."""
    num_neighbours: int = 8
    """Earlier keyframes that see the same and that a new one is registered to, the nearest first."""
    neighbour_distance: float = 1.0
    """A keyframe farther away is no neighbour, metres."""
    neighbour_angle: float = 0.6
    """... nor is one that looks another way by more than this, radians."""
    max_correction: float = 0.1
    """A registration to a neighbour that disagrees with the graph by more than this, metres or radians, is
    not believed: if it is right all the same, it is a loop."""
    edge_sigma_metres: float = 0.005
    """Systematic error of a registration, standard deviation in metres."""
    edge_sigma_radians: float = 0.0035
    """The same in radians."""
    registrations_per_frame: int = 1
    """Registrations of keyframes to each other after each frame, so that none makes a frame late."""
    kernel_width: float = 3.0
    """Width of the Huber kernel of a registration, standard deviations."""
    window: int = 8
    """Newest keyframes whose landmarks are optimised with their poses."""
    max_landmarks: int = 2048
    """Landmarks of a window, the most often seen first."""
    loops: bool = True
    """Whether loops are closed."""
    loop_candidates: int = 2
    """Keyframes outside the neighbourhood that look most like the new one, to be tried as loops."""
    loop_similarity: float = 0.75
    """Least similarity of the image descriptors of a loop."""
    loop_gap: int = 10
    """Keyframes so recent are never loops."""
    loop_inliers: int = 40
    """Least matches that agree with a loop."""
    loop_inlier_fraction: float = 0.4
    """Least share of surface points that agree with a loop."""
    loop_support: int = 2
    """Loops that must agree with each other before any is closed."""
    max_drift: float = 0.08
    """A loop that corrects more than this share of the way since, and 0.3 m, is taken for another place that
    looks the same."""
    max_turn: float = 0.35
    """... and so is one that turns by more than this, radians."""
    relocalisation_candidates: int = 4
    """Keyframes that a lost frame is looked for in."""
    relocalisation_inliers: int = 30
    """Least matches that agree on where a lost frame is."""
    capacity: int = 128
    """Keyframes, and half the registrations, that the solver has room for at first; it doubles when full."""


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
    view_interval: int = 8
    """A view is taken this many frames after the last one, and of keyframes, unless another frame since the
    last keyframe was one less than half as many before."""
    views_in_memory: int = 128
    """Views and keyframes whose images stay in memory; those of older ones are kept on disk."""
    steps_per_frame: int = 0
    """Optimisation steps after each tracked frame."""
    steps_per_view: int = 1
    """Optimisation steps on a new view, the first before Gaussians are set where they are missing."""
    final_steps: int = 1000
    """Optimisation steps over all views after the last frame."""
    newest_share: float = 0.3
    """Share of the steps between views that the newest view gets; the others are drawn uniformly."""
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
    graph: GraphConfig = field(default_factory=GraphConfig)
    """The graph of keyframes."""
    mapping: MappingConfig = field(default_factory=MappingConfig)
    """The Gaussian map."""
    seed: int = 0
    """Seed of the choice of keyframes to optimise."""
    max_skipped_fraction: float = 0.1
    """The run stops when more than this share of the frames could not be decoded (and at least 5)."""
