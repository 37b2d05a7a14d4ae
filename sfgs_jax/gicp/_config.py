"""Settings of registration; each checks itself as it is made."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any, Literal, TypeVar, get_args

from sfgs_jax.arrays import InputError
from sfgs_jax.geometry import Kernel

Residual = Literal["point_to_point", "point_to_plane", "gicp"]
TargetCovariance = Literal["isotropic", "map", "neighbours"]
Optimizer = Literal["gauss_newton", "levenberg_marquardt"]
_T = TypeVar("_T")


def at_level(values: tuple[_T, ...], index: int) -> _T:
    """Entry of a level, counted from the finest; levels beyond the list take its last entry."""
    return values[min(index, len(values) - 1)]


@dataclass(frozen=True)
class PointsConfig:
    """Settings of `prepare_points` and `prepare_gaussians`; static, so a change compiles anew.

    Raises:
        InputError: a setting is out of range.
    """

    levels: int = 4
    """Number of resolutions; the voxels double in size from each level to the next coarser one."""

    voxel_size: float | None = None
    """Edge of the finest voxels, metres; None fits it to the cloud's extent and to `max_points`."""

    relative_voxel_size: float = 0.025
    """Least edge of fitted voxels at the finest level, as a share of the cloud's median radius."""

    max_points: int = 16384
    """Capacity of the finest level, voxels; each coarser level has half. Memory and time depend on it."""

    slots: int = 128
    """Most candidates in the search for the neighbours of a point; a widened search takes four times more. A
    voxel neighbourhood on a surface holds about 40."""

    doublings: int = 2
    """Number of times that the search for k neighbours doubles its reach, from two voxels."""

    min_neighbours: int = 6
    """Least number of neighbours that give a point a normal, itself included; others are left out."""

    min_flatness: float = 0.01
    """Least ratio, about, of the second to the largest variance of a neighbourhood. A smaller one is a line,
    which has no normal, and its point is left out."""

    min_deviation: float = 0.01
    """Least standard deviation of a point's distance from its plane, as a share of the voxel's edge."""

    def __post_init__(self) -> None:
        for name in ("levels", "max_points", "slots", "min_neighbours"):
            _require(self, name, _count(1), "a whole number of at least 1")
        _require(self, "doublings", _count(0), "a whole number of at least 0")
        for name in ("relative_voxel_size", "min_deviation"):
            _require(self, name, _positive, "a finite number above 0")
        if self.voxel_size is not None:
            _require(self, "voxel_size", _positive, "a finite number of metres above 0, or None")
        _require(self, "min_flatness", _within(0.0, 1.0), "a number from 0 to 1")


@dataclass(frozen=True)
class GicpConfig:
    """Settings of `prepare` and `align`; static, so a change compiles anew.

    Settings per level count from the finest. Levels beyond their list take its last entry, and entries beyond
    the levels have no effect.

    Raises:
        InputError: a setting is out of range.
    """

    levels: int = 4
    """Number of resolutions of a depth image, each half the last; the coarsest bears the worst starts."""

    skipped_halvings: int = 1
    """Number of times that a depth image is halved before the finest level: 1 makes 320x240 of 640x480."""

    radius: int = 2
    """Radius of the window of a surface estimate, pixels of its level."""

    edge_tolerance: float = 0.02
    """Largest deviation of a window's depths from a plane, as a share of the depth. A window that deviates
    more straddles a depth edge and is left out."""

    strides: tuple[int, ...] = (2, 2, 1, 1)
    """Step between the rows, and between the columns, of the source pixels to align; per level."""

    min_points: tuple[int, ...] = (4800, 1200, 300, 300)
    """Least number of pixels that strides leave; they shrink for images with fewer. Per level."""

    max_iterations: tuple[int, ...] = (12, 8, 24, 24)
    """Most steps; per level. From a good start a level ends after a few. With none the motion stays as it is,
    and has the derivative of a minimum."""

    optimizer: Optimizer = "gauss_newton"
    """Optimiser. `levenberg_marquardt` adapts the damping, and takes only steps that lower the cost."""

    residual: Residual = "gicp"
    """Residual of a correspondence. The choice `point_to_point` is there for comparison. A projective
    correspondence lies on the viewing ray, so it pulls along that ray even on a slanted surface."""

    epsilon: float = 1e-2
    """Variance of a point along its normal, as a share of its variance within the plane; `gicp` only."""

    max_distance: tuple[float, ...] = (0.1, 0.2, 0.4, 0.8)
    """Largest distance of a correspondence in an organised target, metres; per level. The coarsest level
    bears a start 10 cm and 10 degrees off, which moves a point at 3 m by over half a metre."""

    windows: tuple[int, ...] = (0, 0, 0, 3)
    """Radius of the window around a point's pixel, pixels; per level. In an organised target the point meets
    the nearest one in it: far from the answer the pixel alone misleads."""

    max_voxels: float = 2.0
    """Largest distance of a correspondence in an unorganised target, voxels of the level. The search reaches
    one to two voxels."""

    min_normal_cosine: tuple[float, ...] = (0.7, 0.7, 0.5, 0.5)
    """Least cosine between the two normals of a correspondence; per level."""

    kernel: Kernel = "huber"
    """Robust kernel of the residuals."""

    kernel_width: float = 1.5
    """Width of the robust kernel at the finest level, standard deviations; it doubles at each coarser one."""

    noise: float = 0.002
    """Standard deviation of a depth pixel's distance from the surface at any depth, metres."""

    noise_per_square_metre: float = 0.0015
    """Growth of the depth noise with the square of the depth z: `noise` plus this times z² is its standard
    deviation in metres. A structured-light sensor has 0.0015."""

    damping: float = 1e-4
    """Damping of a step, as a share of the Hessian's diagonal; Levenberg-Marquardt starts with it."""

    min_observability: float = 0.0025
    """Least observability of a direction of motion that is not free. It is the mean square distance along the
    normals that a unit motion makes, weighted like the residuals. Errors of the normals of 0.05 rad alone
    make 0.0025."""

    step_observability: float = 0.0005
    """Least observability of a direction that steps take; in scale like `min_observability`, but lower. Far
    from the answer the correspondences are few and lopsided, and show less of a direction."""

    tolerance: tuple[float, ...] = (2e-4, 1e-3, 3e-3, 1e-2)
    """Length of a step, metres and radians, below which a level has converged; per level."""

    inlier_width: float = 3.0
    """Largest distance of an inlier from the target's surface, standard deviations."""

    min_inliers: int = 100
    """Least number of inliers of a converged result, among the points aligned at the finest level. An
    unorganised target needs this many points too."""

    min_inlier_fraction: float = 0.2
    """Least share of inliers of a converged result, among the source's points at the finest level."""

    def __post_init__(self) -> None:
        for name in ("levels", "radius", "min_inliers"):
            _require(self, name, _count(1), "a whole number of at least 1")
        _require(self, "skipped_halvings", _count(0), "a whole number of at least 0")
        for name in ("strides", "min_points"):
            _require_each(self, name, _count(1), "a whole number of at least 1")
        for name in ("windows", "max_iterations"):
            _require_each(self, name, _count(0), "a whole number of at least 0")
        for name in ("edge_tolerance", "max_voxels", "kernel_width", "noise", "inlier_width"):
            _require(self, name, _positive, "a finite number above 0")
        for name in ("max_distance", "tolerance"):
            _require_each(self, name, _positive, "a finite number above 0")
        for name in ("noise_per_square_metre", "damping", "min_observability", "step_observability"):
            _require(self, name, _not_negative, "a finite number of at least 0")
        _require(self, "epsilon", lambda x: _positive(x) and x <= 1, "a number above 0 and at most 1")
        _require(self, "min_inlier_fraction", _within(0.0, 1.0), "a number from 0 to 1")
        _require_each(self, "min_normal_cosine", _within(-1.0, 1.0), "a number from -1 to 1")
        for name, kind in (("optimizer", Optimizer), ("residual", Residual), ("kernel", Kernel)):
            names = get_args(kind)
            _require(self, name, names.__contains__, f"one of {', '.join(names)}")


def _require(config: Any, name: str, accepts: Callable[[Any], bool], expected: str) -> None:
    """Refuse a setting that is not what it should be."""
    value = getattr(config, name)
    if not accepts(value):
        raise InputError(f"{type(config).__name__}.{name} is {value!r}, but it should be {expected}.")


def _require_each(config: Any, name: str, accepts: Callable[[Any], bool], expected: str) -> None:
    """Refuse a setting per level that is no tuple, is empty, or has an entry that is refused."""

    def accepts_all(values: Any) -> bool:
        return isinstance(values, tuple) and len(values) > 0 and all(map(accepts, values))

    _require(config, name, accepts_all, f"a tuple with at least one entry, each {expected}")


def _count(least: int) -> Callable[[Any], bool]:
    return lambda x: isinstance(x, Integral) and not isinstance(x, bool) and int(x) >= least


def _within(low: float, high: float) -> Callable[[Any], bool]:
    return lambda x: _finite(x) and low <= x <= high


def _positive(x: Any) -> bool:
    return _finite(x) and x > 0


def _not_negative(x: Any) -> bool:
    return _finite(x) and x >= 0


def _finite(x: Any) -> bool:
    return isinstance(x, Real) and not isinstance(x, bool) and math.isfinite(x)
