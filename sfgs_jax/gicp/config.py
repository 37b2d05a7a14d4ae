"""Settings of registration."""

from dataclasses import dataclass
from typing import Literal, TypeVar

from sfgs_jax.geometry.robust_kernels import Kernel

Residual = Literal["point_to_point", "point_to_plane", "gicp"]
TargetCovariance = Literal["isotropic", "map", "neighbours"]
Optimizer = Literal["gauss_newton", "levenberg_marquardt"]
_T = TypeVar("_T")


def at_level(values: tuple[_T, ...], index: int) -> _T:
    """What is given for a level, counted from the finest; levels beyond the list take its last value."""
    return values[min(index, len(values) - 1)]


@dataclass(frozen=True)
class PointsConfig:
    """Settings of `prepare_points` and `prepare_gaussians`; static, so a change compiles anew."""

    levels: int = 4
    """Resolutions, each with voxels of twice the size."""

    voxel_size: float | None = None
    """Edge of the finest voxels, metres; None fits it to the cloud's extent and to `max_points`."""

    relative_voxel_size: float = 0.025
    """Least edge of the finest voxels where they are fitted, as a share of the cloud's median radius."""

    max_points: int = 16384
    """Most voxels at the finest level, half as many at each coarser one: what memory and time depend on."""

    slots: int = 128
    """Most neighbours looked at for one point: a voxel neighbourhood on a surface holds some 40. Where the
    search is widened it is four times as many."""

    doublings: int = 2
    """How often the search for k neighbours is widened, in steps of two, from cells of two voxels."""

    min_neighbours: int = 6
    """A point with fewer has no normal and is left out."""

    min_flatness: float = 0.01
    """A neighbourhood is a line rather than a plane, and left out, if of its two larger variances the
    smaller is below about this share of the larger."""

    min_deviation: float = 0.01
    """Least standard deviation of a distance from a plane, as a share of the voxel's edge."""


@dataclass(frozen=True)
class GicpConfig:
    """Settings of `prepare` and `align`; static, so a change compiles anew.

    What is given per level counts from the finest; levels beyond the list take its last value.
    """

    levels: int = 4
    """Resolutions in the pyramid, each half the last; the coarsest decides how far off a start may be."""

    skipped_halvings: int = 1
    """How often the depth image is halved before the finest level: 1 makes a 320x240 level of 640x480."""

    radius: int = 2
    """Radius of the window of a surface estimate, pixels of its level."""

    edge_tolerance: float = 0.02
    """Share of the depth beyond which a window is taken to straddle a depth edge."""

    strides: tuple[int, ...] = (2, 2, 1, 1)
    """Per level from the finest: every stride-th row and column of the source is aligned."""

    min_points: tuple[int, ...] = (4800, 1200, 300, 300)
    """Per level from the finest: strides are smaller where they would leave fewer pixels than this."""

    max_iterations: tuple[int, ...] = (12, 8, 24, 24)
    """Per level from the finest: most steps. From a good start a level ends after a few."""

    optimizer: Optimizer = "gauss_newton"
    """`levenberg_marquardt` takes a step only if it lowers the cost, at the damping that does."""

    residual: Residual = "gicp"
    """What a correspondence measures. A projective correspondence lies on the viewing ray, so
    `point_to_point` pulls along that ray even where the surface is slanted: it is there for comparison."""

    epsilon: float = 1e-2
    """GICP: variance of a point along its normal, as a share of that within its plane."""

    max_distance: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    """Per level from the finest: correspondences farther apart are dropped, metres. The coarsest level has to
    bear a start that is 10 cm and 10 degrees off, which moves a point at 3 m by more than half a metre."""

    windows: tuple[int, ...] = (0, 0, 0, 3)
    """Per level from the finest: in an organised target a point meets the nearest one in a window of this
    radius around its pixel, pixels. Far from the answer the pixel alone misleads."""

    max_voxels: float = 2.0
    """The same for unorganised targets, in voxels of the level; 1 to 2 is what the search reaches."""

    min_normal_cosine: tuple[float, ...] = (0.7, 0.7, 0.5, 0.5)
    """Per level from the finest: correspondences whose normals differ more are dropped."""

    kernel: Kernel = "huber"
    """Robust kernel of the residuals."""

    kernel_width: float = 1.5
    """Width of the kernel in standard deviations, at the finest level; doubled at each coarser one."""

    noise: float = 0.002
    """Standard deviation of a surface distance whatever the depth, metres."""

    noise_per_square_metre: float = 0.0015
    """What a depth of z metres adds to that deviation, times z²: a structured-light sensor's 0.0015."""

    damping: float = 1e-4
    """Added to the normal equations, as a share of their diagonal; where Levenberg-Marquardt starts."""

    min_observability: float = 0.0025
    """A direction of motion is free if the distance along the normals that a unit motion makes has a smaller
    mean square, weighed like the residuals: errors of the normals of 0.05 rad make as much of none."""

    step_observability: float = 0.0005
    """No step goes along a direction below this. It is lower because correspondences far from the answer are
    few and lopsided, and then show less of a direction than there is."""

    tolerance: tuple[float, ...] = (2e-4, 1e-3, 3e-3, 1e-2)
    """Per level from the finest: it is done when a step is shorter than this, metres and radians. What a
    coarser level leaves, the next one takes care of."""

    inlier_width: float = 3.0
    """An inlier lies within this many standard deviations of the target's surface."""

    min_inliers: int = 100
    """Fewer inliers than this among the points aligned at the finest level, or fewer points in an unorganised
    target, and the result is not called converged."""

    min_inlier_fraction: float = 0.2
    """A smaller share of inliers and the result is not called converged."""
