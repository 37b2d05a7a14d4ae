"""Every setting refuses numbers without a meaning, in one sentence."""

import copy
import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import pytest

from sfgs_jax import factor_graph, gicp, slam, splatting, superfeats
from sfgs_jax.arrays import InputError
from sfgs_jax.cli import RunOptions
from sfgs_jax.datasets import ReaderOptions
from sfgs_jax.superfeats.network import NetworkConfig
from sfgs_jax.superfeats.training import ViewConfig

ROOTS = (
    *(slam.SlamConfig(), ReaderOptions(depth_scale=1.0, max_depth=1.0, end=1), RunOptions(refine=1.0)),
    *(factor_graph.SolverConfig(), gicp.PointsConfig(voxel_size=0.1), splatting.RenderConfig()),
    *(superfeats.MotionFilterConfig(), NetworkConfig(), ViewConfig()),
)

NEGATIVE = {
    *("GraphConfig.loop_similarity", "GicpConfig.min_normal_cosine"),
}
"""Settings that may be -1: cosines."""

NOT_ZERO = {
    *("FeaturesConfig.max_keypoints", "FeaturesConfig.max_rigid_matches", "FeaturesConfig.kernel_width"),
    *("FeaturesConfig.pixel_sigma", "FeaturesConfig.max_distance", "FeaturesConfig.inlier_pixels"),
    *("FeaturesConfig.patch_sigma", "FeaturesConfig.patch_kernel_width"),
    *("TrackingConfig.num_references", "TrackingConfig.motion_model_sigma", "TrackingConfig.delay_sigma"),
    *("GicpConfig.levels", "GicpConfig.radius", "GicpConfig.strides"),
    *("GicpConfig.noise", "GicpConfig.kernel_width", "GicpConfig.max_distance", "GicpConfig.epsilon"),
    *("GraphConfig.capacity", "GraphConfig.registrations_per_frame", "GraphConfig.backlog"),
    *("GraphConfig.edge_sigma_metres", "GraphConfig.kernel_width", "GraphConfig.max_landmarks"),
    *("MappingConfig.max_width", "MappingConfig.capacity"),
    *("MappingConfig.view_interval", "MappingConfig.prune_interval"),
    *("MappingConfig.max_view_shift", "SeedingConfig.min_cell", "SeedingConfig.max_cell"),
    *("SeedingConfig.opacity", "SeedingConfig.scale", "SeedingConfig.thickness", "SeedingConfig.max_depth"),
    *("ReaderOptions.depth_scale", "ReaderOptions.max_depth", "ReaderOptions.stride"),
    *("SolverConfig.max_iterations", "SolverConfig.min_damping", "RenderConfig.tile_size"),
    *("RenderConfig.pair_capacity", "RenderConfig.near", "RenderConfig.far", "PointsConfig.levels"),
    *("PointsConfig.max_points", "PointsConfig.voxel_size", "NetworkConfig.context", "RunOptions.view_port"),
}
"""Settings of which none, or a size of nothing, would hang, divide by zero or mean nothing."""


def settings(config: Any) -> Iterator[tuple[Any, str]]:
    """Every number among the settings and those inside them, with the dataclass that holds it."""
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            yield from settings(value)
        elif isinstance(value, tuple | int | float) and not isinstance(value, bool):
            yield config, field.name


EVERY = {
    f"{type(config).__name__}.{name}": (config, name) for root in ROOTS for config, name in settings(root)
}


def refused(setting: str, number: float) -> bool:
    """Whether a number is refused in its place; in place of each number if the setting has several."""
    config, name = EVERY[setting]
    value = getattr(config, name)
    # Not `replace`, whose types other tests check.
    changed = copy.copy(config)
    object.__setattr__(changed, name, (number,) * len(value) if isinstance(value, tuple) else number)
    try:
        changed.__post_init__()
    except InputError as error:
        text = str(error)
        assert text.endswith(".")
        assert name in text or type(config).__name__ in text
        return True
    return False


@pytest.mark.parametrize("setting", EVERY)
def test_a_number_without_a_meaning_is_refused(setting):
    for number in (math.nan, math.inf, -math.inf):
        assert refused(setting, number), number
    assert refused(setting, -1) or setting in NEGATIVE
    assert refused(setting, 0) or setting not in NOT_ZERO


def test_the_lists_name_settings():
    assert not (NEGATIVE | NOT_ZERO).difference(EVERY)
    assert len(EVERY) > 120


def test_an_extrinsic_without_the_estimate_that_it_belongs_to_is_refused():
    with pytest.raises(InputError, match="`estimate_extrinsic` needs `estimate_depth`"):
        slam.TrackingConfig(estimate_extrinsic=True)
