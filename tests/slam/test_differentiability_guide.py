"""The guide to derivatives: its table names tests, its examples hold, and tracking has the slopes it says."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from sfgs_jax.gicp import GicpConfig
from sfgs_jax.slam import FeaturesConfig

ROOT = Path(__file__).parents[2]
GUIDE = (ROOT / "docs" / "differentiability.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def examples() -> dict[str, Any]:
    """Names of the guide's examples, once they have run."""
    names: dict[str, Any] = {}
    exec("\n".join(re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL)), names)  # the text is our own
    return names


def test_equal_weights_are_the_default():
    assert FeaturesConfig().match_weights == "equal"


def test_every_row_names_a_test_that_exists():
    rows = re.findall(r"^\| `.*\|$", GUIDE, re.MULTILINE)
    named = re.findall(r"`(tests/\S+\.py)::(\w+)`", GUIDE)
    assert len(rows) == len(named) > 10
    for file, test in named:
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8")


def test_the_examples_hold(examples):
    assert float(examples["value"]) != 0


def in_float64(tree: Any) -> Any:
    return jax.tree.map(
        lambda x: jnp.asarray(x, jnp.float64) if eqx.is_inexact_array_like(x) else x,
        tree,
    )


@pytest.mark.usefixtures("float64")
@pytest.mark.parametrize("weights", ["equal", "learned"])
def test_a_tracked_pose_has_the_slopes_of_finite_differences(examples, rng, weights):
    # Steps down to rounding, so that a difference of two poses is that of two optima.
    exact = GicpConfig(
        levels=1, strides=(1,), max_iterations=(60,), tolerance=(1e-13,), damping=1e-12, skipped_halvings=0
    )
    params = examples["params"]
    features = replace(params.config.features, match_weights=weights)
    params = replace(params, config=replace(params.config, gicp=exact, features=features))
    *inputs, tracker = in_float64((params, *examples["inputs"][1:], examples["tracker"]))

    def directions(part):
        # Weights move in proportion, missing depth stays missing; a grid of zeros moves by itself.
        return jax.tree.map(
            lambda x: (x if np.any(x) else 0.01) * rng.normal(size=x.shape) if eqx.is_inexact_array(x) else x,
            part,
        )

    with jax.numpy_dtype_promotion("standard"):  # indices are int64 here
        _, gradients = examples["moved"](inputs, tracker)
        parts = {
            "intrinsics": lambda tree: tree[0].camera,
            "network": lambda tree: tree[0].network,
            **({"descriptors": lambda tree: tree[0].network.describe} if weights == "learned" else {}),
            **({"reliability": lambda tree: tree[0].network.rely} if weights == "learned" else {}),
            "times of the rows": lambda tree: tree[0].timing,
            "depth grid": lambda tree: tree[0].depth_correction.offsets,
            "image": lambda tree: tree[1][-1],
            "depth": lambda tree: tree[2][-1],
            "earlier images": lambda tree: tree[1][:-1],
            "earlier depths": lambda tree: tree[2][:-1],
            "seconds": lambda tree: tree[3],
        }
        for name, part in parts.items():
            along = eqx.filter(directions(part(inputs)), eqx.is_inexact_array)
            products = jax.tree.map(np.vdot, eqx.filter(part(gradients), eqx.is_inexact_array), along)
            ends = []
            for step in (1e-7, -1e-7):
                shifted = eqx.apply_updates(part(inputs), jax.tree.map(lambda x, s=step: s * x, along))
                ends.append(float(examples["moved"](eqx.tree_at(part, inputs, shifted), tracker)[0][0]))
            expected = (ends[0] - ends[1]) / 2e-7
            assert sum(jax.tree.leaves(products)) == pytest.approx(expected, rel=1e-4), name
            assert abs(expected) > 1e-6, name
