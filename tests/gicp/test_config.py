"""Settings refuse values out of range; the sentence names the setting, the value and the rule."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.gicp import GicpConfig, PointsConfig

GICP, POINTS = GicpConfig(), PointsConfig()
NAN, INFINITY = math.nan, math.inf


def refuse(config, name: str, value, rule: str) -> None:
    with pytest.raises(InputError) as error:
        replace(config, **{name: value})
    assert str(error.value) == f"{type(config).__name__}.{name} is {value!r}, but it should be {rule}."


@pytest.mark.parametrize(
    ("config", "name"),
    [
        *((GICP, name) for name in ("levels", "radius", "min_inliers")),
        *((POINTS, name) for name in ("levels", "max_points", "slots", "min_neighbours")),
    ],
)
@pytest.mark.parametrize("value", [0, -3, True])
def test_counts(config, name, value):
    refuse(config, name, value, "a whole number of at least 1")


@pytest.mark.parametrize(("config", "name"), [(GICP, "skipped_halvings"), (POINTS, "doublings")])
@pytest.mark.parametrize("value", [-1, False])
def test_counts_that_may_be_zero(config, name, value):
    assert getattr(replace(config, **{name: 0}), name) == 0
    refuse(config, name, value, "a whole number of at least 0")


@pytest.mark.parametrize(
    ("config", "name"),
    [
        *((GICP, name) for name in ("edge_tolerance", "max_voxels", "kernel_width", "noise", "inlier_width")),
        *((POINTS, name) for name in ("relative_voxel_size", "min_deviation")),
    ],
)
@pytest.mark.parametrize("value", [0.0, -0.1, NAN, INFINITY])
def test_widths_and_deviations(config, name, value):
    refuse(config, name, value, "a finite number above 0")


@pytest.mark.parametrize("value", [0.0, -0.1, NAN, INFINITY])
def test_voxel_size(value):
    refuse(POINTS, "voxel_size", value, "a finite number of metres above 0, or None")
    assert replace(POINTS, voxel_size=0.1).voxel_size == 0.1


@pytest.mark.parametrize(
    "name", ["noise_per_square_metre", "damping", "min_observability", "step_observability"]
)
@pytest.mark.parametrize("value", [-1e-9, NAN, INFINITY])
def test_numbers_that_may_be_zero(name, value):
    assert getattr(replace(GICP, **{name: 0.0}), name) == 0
    refuse(GICP, name, value, "a finite number of at least 0")


@pytest.mark.parametrize("value", [-0.1, 1.1, NAN])
def test_shares(value):
    refuse(GICP, "min_inlier_fraction", value, "a number from 0 to 1")
    refuse(POINTS, "min_flatness", value, "a number from 0 to 1")
    refuse(GICP, "epsilon", value, "a number above 0 and at most 1")
    refuse(GICP, "epsilon", 0.0, "a number above 0 and at most 1")


@pytest.mark.parametrize(
    ("names", "wrong", "rule"),
    [
        (("strides", "min_points"), 0, "a whole number of at least 1"),
        (("windows", "max_iterations"), -1, "a whole number of at least 0"),
        (("max_distance", "tolerance"), 0.0, "a finite number above 0"),
        (("min_normal_cosine",), 1.5, "a number from -1 to 1"),
    ],
)
def test_settings_per_level(names, wrong, rule):
    rule = f"a tuple with at least one entry, each {rule}"
    for name in names:
        default = getattr(GICP, name)
        for values in ((), (*default, wrong), (wrong, *default)):
            refuse(GICP, name, values, rule)
        assert getattr(replace(GICP, **{name: default[:1]}), name) == default[:1]


def test_nan_among_settings_per_level():
    rule = "a tuple with at least one entry, each a finite number above 0"
    refuse(GICP, "max_distance", (0.1, NAN), rule)
    refuse(GICP, "tolerance", (NAN,), rule)
    refuse(GICP, "min_normal_cosine", (NAN,), "a tuple with at least one entry, each a number from -1 to 1")


WRONG_TYPES = """
from numpy import float32, int64
from sfgs_jax.arrays import InputError
from sfgs_jax.gicp import GicpConfig, PointsConfig

def refused(config, expected, **settings):
    try:
        config(**settings)
    except InputError as error:
        assert str(error).endswith(f", but it should be {expected}."), error
    else:
        raise AssertionError(settings)

count = "a whole number of at least 1"
refused(GicpConfig, count, levels=2.0)
refused(GicpConfig, count, radius=float("nan"))
refused(PointsConfig, count, slots="many")
refused(PointsConfig, "a finite number above 0", min_deviation=None)
refused(GicpConfig, f"a tuple with at least one entry, each {count}", strides=[2, 1])
refused(GicpConfig, f"a tuple with at least one entry, each {count}", strides=2)
refused(GicpConfig, f"a tuple with at least one entry, each {count}", min_points=(2.5,))
refused(GicpConfig, "one of gauss_newton, levenberg_marquardt", optimizer="adam")
refused(GicpConfig, "one of point_to_point, point_to_plane, gicp", residual="plane")
kernels = "none, huber, cauchy, geman_mcclure, tukey, dynamic_covariance_scaling"
refused(GicpConfig, f"one of {kernels}", kernel="l1")
assert GicpConfig(levels=int64(3), noise=float32(0.5)).levels == 3
"""


def test_values_of_other_types():
    """Without the run-time type checks of the tests, which would speak first."""
    subprocess.run([sys.executable, "-c", WRONG_TYPES], cwd=Path(__file__).parents[2], check=True)


def test_settings_are_hashable():
    assert hash(GicpConfig()) == hash(GicpConfig())
    assert hash(PointsConfig()) == hash(PointsConfig())
    assert GicpConfig(levels=3) == GicpConfig(levels=3) != GicpConfig()
