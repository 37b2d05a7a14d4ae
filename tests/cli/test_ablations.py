"""Every ablation changes one part of the settings."""

import dataclasses

import pytest

from sfgs_jax.arrays import InputError
from sfgs_jax.cli import ABLATIONS, ablated
from sfgs_jax.slam import SlamConfig


def leaves(config, prefix: str = "") -> dict[str, object]:
    """Settings by their dotted names."""
    found: dict[str, object] = {}
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), f"{prefix}{field.name}"
        found |= leaves(value, f"{name}.") if dataclasses.is_dataclass(value) else {name: value}
    return found


CHANGES = {
    "none": {},
    "no-gicp": {"tracking.use_surface": False},
    "no-features": {"tracking.features.kind": "none"},
    "orb": {"tracking.features.kind": "orb"},
    "no-graph": {"graph.enabled": False},
    "no-loops": {"graph.loops": False},
    "no-window": {"graph.window": 0},
}


@pytest.mark.parametrize("ablation", ABLATIONS)
def test_an_ablation_changes_its_setting_and_no_other(ablation):
    before = SlamConfig(seed=3)
    after = leaves(ablated(before, ablation))
    assert after == leaves(before) | CHANGES[ablation]
    assert after != leaves(before) or ablation == "none"


def test_something_must_be_left_to_track_with():
    without_gicp = ablated(SlamConfig(), "no-gicp")
    with pytest.raises(InputError, match="nothing is left to track with"):
        ablated(without_gicp, "no-features")
