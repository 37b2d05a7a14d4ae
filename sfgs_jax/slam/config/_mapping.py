"""Settings of mapping: seeding, the loss and its optimiser, the choice of views."""

import math
from dataclasses import dataclass, field

from sfgs_jax.arrays import InputError, check_counts, check_positive, check_range

_GAUSSIAN_BYTES = 177
"""A Gaussian without view dependence has 14 numbers with two moments each, its updates, keyframe and flag."""


@dataclass(frozen=True)
class LearningRates:
    """Adam's learning rate for each parameter of the Gaussians."""

    means: float = 1e-3
    """Learning rate of the means, metres."""
    quaternions: float = 1e-2
    """Learning rate of the unnormalised quaternions."""
    log_scales: float = 2.5e-2
    """Learning rate of the logarithms of the scales."""
    opacity_logits: float = 0.1
    """Learning rate of the opacities before the sigmoid."""
    sh: float = 0.05
    """Learning rate of the spherical-harmonics coefficients."""
    poses: float = 3e-4
    """Step of a view's pose along each direction in the refinement, metres and radians. The image tells
    only which way to go. 0 leaves the poses as they were tracked."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, math.inf, "means", "quaternions", "log_scales", "opacity_logits", "sh", "poses")


@dataclass(frozen=True)
class SeedingConfig:
    """Placement and start of new Gaussians."""

    min_cell: int = 2
    """Side of the smallest cell of a view's image that gets a Gaussian of its own, pixels."""
    max_cell: int = 8
    """Side of the largest cell, pixels: the smallest one doubled some times."""
    colour_tolerance: float = 0.08
    """Standard deviation of a colour channel, in [0, 1], beyond which a cell is divided into four."""
    min_alpha: float = 0.6
    """Accumulated opacity below which a pixel gets a Gaussian."""
    depth_margin: float = 0.05
    """Distance by which a pixel's surface must lie in front of the map's to get a Gaussian, as a share of
    its depth."""
    opacity: float = 0.9
    """Opacity of a new Gaussian."""
    scale: float = 0.55
    """Standard deviation of a new Gaussian along the surface, in sides of its cell."""
    thickness: float = 0.3
    """Standard deviation of a new Gaussian across the surface, as a share of that along it."""
    max_depth: float = 12.0
    """Depth beyond which no Gaussians are set while the recording lasts, metres."""
    filled_opacity: float = 0.5
    """Opacity of the Gaussians that the refinement sets where no view has measured depth; with 0 it sets
    none."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_counts(self, 1, "min_cell", "max_cell")
        check_range(self, 0, 1, "min_alpha", "colour_tolerance")
        check_range(self, 0, 0.99, "filled_opacity")
        check_range(self, 0, math.inf, "depth_margin")
        check_positive(self, "opacity", "scale", "thickness", "max_depth")
        doublings = self.max_cell // self.min_cell
        if self.max_cell % self.min_cell or doublings & (doublings - 1):
            raise InputError(
                f"The setting max_cell must be min_cell ({self.min_cell}) doubled some times, "
                f"not {self.max_cell!r}."
            )
        if not self.opacity < 1:
            raise InputError(f"The setting opacity must be a number between 0 and 1, not {self.opacity!r}.")


@dataclass(frozen=True)
class OptimisationConfig:
    """Loss and learning rates of a map step."""

    ssim_weight: float = 0.2
    """Weight of 1 - SSIM against L1 in the colour loss."""
    depth_weight: float = 0.1
    """Weight of the depth loss (L1, metres)."""
    estimate_exposure: bool = True
    """Estimate a gain of each colour channel for each view. Then the map need not take on the camera's
    automatic exposure and white balance."""
    momentum: float = 0.2
    """Decay of Adam's mean gradient. Each step is on another view, and what earlier ones wanted is out of
    date. With the customary 0.9 a map needs more steps."""
    learning_rates: LearningRates = field(default_factory=LearningRates)
    """Adam's learning rates."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_range(self, 0, 1, "ssim_weight")
        check_range(self, 0, 0.99, "momentum")
        check_range(self, 0, math.inf, "depth_weight")


@dataclass(frozen=True)
class PagingConfig:
    """Gaussians of far places, which leave a map that is full for the disk."""

    memory_mb: float = 48.0
    """Memory for Gaussians and the moments of their optimiser, MiB. Before it is full, Gaussians of far
    places leave the map. They come back with the first view of their surface."""
    reach: float = 4.0
    """Distance from the camera within which Gaussians never leave, metres."""
    place_keyframes: int = 16
    """Keyframes in a row whose Gaussians leave together."""

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_positive(self, "memory_mb")
        check_range(self, 0, math.inf, "reach")
        check_counts(self, 1, "place_keyframes")

    @property
    def most_gaussians(self) -> int:
        """Gaussians that `memory_mb` has room for."""
        return int(self.memory_mb * 2**20) // _GAUSSIAN_BYTES


@dataclass(frozen=True)
class MappingConfig:
    """Growth and optimisation of the map."""

    max_width: int = 640
    """Largest width of the views' images, pixels. Larger ones are reduced by the smallest whole factor."""
    capacity: int = 131_072
    """Gaussians that the map has room for at first. It doubles when full."""
    max_capacity: int = 1_048_576
    """Gaussians beyond which the map does not grow. The number left out is reported."""
    pair_capacity: int = 0
    """Pairs of tile and Gaussian that a rendering has room for at first; 0 means 1.7 for each pixel of a
    view. It grows when a view needs more."""
    view_interval: int = 8
    """Frames between two views. A keyframe is a view too, unless an ordinary view was taken less than half
    an interval ago."""
    extra_interval: int = 2
    """Frames between two images that are kept for the refinement, views among them; 0 keeps views alone. An
    extra one is not compared with the map when it comes."""
    extra_until: int = 128
    """Views, extra ones among them, beyond which no more extra ones are kept."""
    views_per_keyframe: int = 16
    """Most views that belong to one keyframe. It bounds what a camera that stays in a place takes. A camera
    that is carried through rooms has up to 8."""
    views_in_memory: int = 128
    """Views and keyframes whose images stay in memory. Older ones are kept on disk."""
    steps_per_frame: int = 0
    """Map steps after each tracked frame."""
    steps_per_view: int = 0
    """Map steps on a new view. The first comes before Gaussians are set where they are missing. With none the
    view is only rendered, to see where they are."""
    max_view_shift: float = 0.15
    """Shift of the image since the last view with which a frame becomes a view at once, as a share of its
    width."""
    final_steps: int = 1000
    """Map steps over all views after the last frame: the refinement."""
    final_seconds: float = 0.0
    """Seconds of refinement in place of a number of steps, compilation left out; 0 means `final_steps`. A run
    with it does not repeat itself to the bit."""
    first_rate: float = 2.5
    """Factor on the Gaussians' learning rates that the refinement begins with."""
    final_rate: float = 0.1
    """Share of its first learning rates that the refinement ends with."""
    late_share: float = 0.05
    """Share of the frames that may come late for the map's sake, in real time. Once more are late, the map
    waits. A larger share gives a fuller map while the run lasts, and drops more frames."""
    newest_share: float = 0.3
    """Share of the map steps that goes to the newest view. The others go to views drawn uniformly."""
    prune_interval: int = 200
    """Map steps between two removals of transparent Gaussians."""
    prune_opacity: float = 0.02
    """Opacity below which Gaussians are removed."""
    paging: PagingConfig = field(default_factory=PagingConfig)
    """Gaussians of far places."""
    seeding: SeedingConfig = field(default_factory=SeedingConfig)
    """New Gaussians."""
    optimisation: OptimisationConfig = field(default_factory=OptimisationConfig)
    """Loss and learning rates."""

    @property
    def gaussians_in_memory(self) -> int:
        """Gaussians of the largest map that `paging.memory_mb` has room for: its slots take the memory."""
        slots, most = self.capacity, self.paging.most_gaussians
        while 2 * slots <= most:
            slots *= 2
        return min(slots, most)

    def __post_init__(self) -> None:
        """Refuse values that have no meaning."""
        check_counts(self, 1, "max_width", "capacity")
        check_counts(self, 0, "pair_capacity")
        check_counts(self, 1, "view_interval", "views_per_keyframe", "prune_interval")
        check_counts(self, self.capacity, "max_capacity")
        check_counts(
            self,
            0,
            "extra_interval",
            "extra_until",
            "views_in_memory",
            "steps_per_frame",
            "steps_per_view",
            "final_steps",
        )
        check_range(self, 0, 1, "newest_share", "late_share", "prune_opacity", "final_rate")
        check_range(self, 0, math.inf, "first_rate")
        check_range(self, 0, math.inf, "final_seconds")
        check_positive(self, "max_view_shift")
