"""Settings of depth registration."""

from dataclasses import dataclass
from typing import Literal

Residual = Literal["point_to_point", "point_to_plane", "gicp"]
Kernel = Literal["none", "huber", "geman_mcclure"]


@dataclass(frozen=True)
class GicpConfig:
    """Settings of `prepare` and `align`; static, so a change compiles anew."""

    levels: int = 3
    """Resolutions in the pyramid, each half the one before."""

    skipped_halvings: int = 1
    """How often the depth image is halved before the finest level: 1 makes a 320x240 level of 640x480."""

    radius: int = 2
    """Radius of the window of a surface estimate, pixels of its level."""

    edge_tolerance: float = 0.02
    """Share of the depth beyond which a window is taken to straddle a depth edge."""

    strides: tuple[int, ...] = (2, 1, 1)
    """Per level from the finest: every stride-th row and column of the source is aligned."""

    max_iterations: tuple[int, ...] = (12, 8, 8)
    """Per level from the finest: most Gauss-Newton steps."""

    residual: Residual = "gicp"
    """What a correspondence measures. A projective correspondence lies on the viewing ray, so
    `point_to_point` pulls along that ray even where the surface is slanted: it is there for comparison."""

    epsilon: float = 1e-2
    """GICP: variance of a point along its normal, as a share of that within its plane."""

    max_distance: float = 0.1
    """Correspondences farther apart are dropped, metres at the finest level; doubled at each coarser one."""

    min_normal_cosine: float = 0.7
    """Correspondences whose normals differ more are dropped."""

    kernel: Kernel = "huber"
    """Robust kernel of the residuals."""

    kernel_width: float = 1.5
    """Width of the kernel in standard deviations, at the finest level; doubled at each coarser one."""

    noise: float = 0.002
    """Standard deviation of a surface distance whatever the depth, metres."""

    noise_per_square_metre: float = 0.0015
    """What a depth of z metres adds to that deviation, times z²: a structured-light sensor's 0.0015."""

    damping: float = 1e-4
    """Added to the normal equations, as a share of their diagonal."""

    tolerance: float = 2e-4
    """A level is done when a step is shorter than this, metres and radians."""

    inlier_width: float = 3.0
    """An inlier lies within this many standard deviations of the target's surface."""

    min_inliers: int = 100
    """Fewer inliers than this at the finest level and the result is not called converged."""

    min_inlier_fraction: float = 0.2
    """A smaller share of inliers and the result is not called converged."""
