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

from sfgs_jax import slam
from sfgs_jax.geometry import se3
from sfgs_jax.gicp import GicpConfig
from sfgs_jax.sensors import DEPTH_GRID, DepthCorrection, SensorModel, SensorTiming, undistorted
from sfgs_jax.slam import FeaturesConfig
from sfgs_jax.slam.state import no_timing_information

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
    # The first frame is registered to nothing, and has a derivative of 0 all the same.
    by = [examples[name] for name in ("by_params", "by_images", "by_depths")]
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(by))


def in_float64(tree: Any) -> Any:
    return jax.tree.map(
        lambda x: np.asarray(x, np.float64) if eqx.is_inexact_array_like(x) else x,
        tree,
    )


def moved_by(step: float, inputs: Any, rates: Any) -> Any:
    """The inputs a step along their rates, which are None where there are none."""
    return jax.tree.map(
        lambda rate, x: x if rate is None else x + step * rate, rates, inputs, is_leaf=lambda x: x is None
    )


_EVERY, _LAST, _EARLIER = slice(None), slice(-1, None), slice(-1)
PARTS: dict[str, tuple[Any, slice | None]] = {
    "intrinsics": (lambda tree: tree[0].camera, None),
    "network": (lambda tree: tree[0].network, None),
    "descriptors": (lambda tree: tree[0].network.describe, None),
    "reliability": (lambda tree: tree[0].network.rely, None),
    "times of the rows": (lambda tree: tree[0].timing, None),
    "depth grid": (lambda tree: tree[0].depth_correction.offsets, _EVERY),
    "extrinsic": (lambda tree: tree[0].depth_correction.extrinsic, _EVERY),
    "image": (lambda tree: tree[1], _LAST),
    "depth": (lambda tree: tree[2], _LAST),
    "earlier images": (lambda tree: tree[1], _EARLIER),
    "earlier depths": (lambda tree: tree[2], _EARLIER),
    "noise": (lambda tree: tree[0].noise, None),
    "seconds": (lambda tree: tree[3], _EVERY),
    "lens": (lambda tree: tree[4], _EVERY),
}
"""What the pose depends on: its place among the inputs, and which of several frames are moved."""


def _with_room(params, tracker, shape):
    """The tracker with room for the images of patches, and for what frames tell of depth's errors."""
    # NumPy's arrays: in JAX's, each operation that prepares them is one more program to compile.
    image = np.zeros(shape, np.float32)
    rings = np.zeros((params.config.num_references, *shape), np.float32), image
    told = no_timing_information(len(params.depth_root), image.dtype)
    return eqx.tree_at(lambda t: (t.references.grey, t.last.grey, t.timing), tracker, (*rings, told))


@pytest.mark.usefixtures("float64")
def test_a_tracked_pose_has_the_slopes_of_finite_differences(examples, rng):
    """The last pose of a sequence, in forward mode: the guide's example is in reverse mode."""
    # Steps down to rounding, so that a difference of two poses is that of two optima.
    exact = GicpConfig(
        levels=1, strides=(1,), max_iterations=(60,), tolerance=(1e-13,), damping=1e-12, skipped_halvings=0
    )
    settings = examples["settings"]
    features = replace(
        settings.features,
        match_weights="learned",
        align_patches=True,
        max_iterations=100,
        tolerance=1e-13,
        patch_steps=200,
    )
    settings = replace(settings, gicp=exact, features=features, estimate_timing=True, estimate_depth=True)
    # Not zero: there the rays would lie on the pixels, where interpolation has a kink.
    extrinsic = jnp.asarray([0.003, -0.002, 0.004, 0.002, -0.003, 0.001], jnp.float32)
    correction = DepthCorrection(jnp.zeros(DEPTH_GRID, jnp.float32), extrinsic)
    known = SensorModel(timing=SensorTiming(0.004, 0.01, 0.008), depth=correction)
    params = slam.tracker_params(examples["recording"].camera, settings, known)
    lens = np.asarray([0.02, -0.01, 0.001, -0.002, 0.005])
    tracker = _with_room(params, examples["tracker"], examples["inputs"][1].shape[1:3])
    *inputs, tracker = in_float64((params, *examples["inputs"][1:], lens, tracker))

    @eqx.filter_jit
    def pose_and_rate(inputs, rates, tracker):
        def last(inputs):
            params, images, depths, elapsed, lens = inputs
            images, depths = jax.vmap(undistorted, (0, 0, None, None))(images, depths, params.camera, lens)
            _, found = slam.track_sequence(params, tracker, images, depths, elapsed)
            return se3.log(found.T_world_cam)[-1] @ jnp.arange(1.0, 7)

        return eqx.filter_jvp(last, (inputs,), (rates,))

    zero = jax.tree.map(lambda x: np.zeros_like(x) if eqx.is_inexact_array_like(x) else None, inputs)

    def moved_along(x):
        # Weights move in proportion, missing depth stays missing; a grid of zeros moves by itself.
        return (x if np.any(x) else 0.01) * rng.normal(size=x.shape)

    with jax.numpy_dtype_promotion("standard"):  # indices are int64 here
        shapes = jax.eval_shape(slam.track, inputs[0], tracker, *(x[0] for x in inputs[1:4]))[0]
        tracker = jax.tree.map(lambda x, like: x.astype(like.dtype), tracker, shapes)
        for name, (part, rows) in PARTS.items():
            along = jax.tree.map(moved_along, eqx.filter(part(inputs), eqx.is_inexact_array_like))
            if rows is not None:
                kept, along = along[rows], np.zeros_like(along)
                along[rows] = kept
            rates = eqx.tree_at(part, zero, along)
            _, rate = pose_and_rate(inputs, rates, tracker)
            ends = [pose_and_rate(moved_by(step, inputs, rates), rates, tracker)[0] for step in (1e-7, -1e-7)]
            expected = float(ends[0] - ends[1]) / 2e-7
            # A rounding of 1e-15 in each of the two poses is 1e-8 of their slope.
            assert float(rate) == pytest.approx(expected, rel=1e-4, abs=1e-8), name
            assert abs(expected) > 1e-6, name
